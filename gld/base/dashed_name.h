#pragma once

#include <algorithm>
#include <string>

namespace gld {

// Options have underscores in YAML and in code, and dashes on the command line: "orbit_center" as "orbit-center".
inline std::string dashed_name(std::string name) {
  std::replace(name.begin(), name.end(), '_', '-');
  return name;
}

}  // namespace gld
