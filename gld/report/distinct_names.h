#pragma once

#include <string>
#include <unordered_set>

namespace gld {

// Names of files for things of which two may have one name, and a name folders in it: the second "room" is "room_2",
// "left/001" is "left_001".
class DistinctNames {
 public:
  std::string of(const std::string& name);

 private:
  std::unordered_set<std::string> taken_;
};

}  // namespace gld
