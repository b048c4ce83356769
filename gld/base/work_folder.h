#pragma once

#include "gld/base/interrupt.h"

#include <filesystem>
#include <memory>
#include <string>

namespace gld {

// A folder below the system's temporary one for what another program reads and writes, removed at the end unless it is
// kept for somebody to look at.
class WorkFolder {
 public:
  // name is what it is for, "colmap": the folder's name begins with it. Throws Error where none can be made.
  explicit WorkFolder(const std::string& name);
  ~WorkFolder();
  WorkFolder(const WorkFolder&) = delete;
  WorkFolder& operator=(const WorkFolder&) = delete;

  const std::filesystem::path& path() const { return path_; }
  // Returns where what the program prints goes: NAME.log.
  std::filesystem::path log() const { return path_ / (name_ + ".log"); }
  void keep() { unfinished_.reset(); }

 private:
  std::string name_;
  std::filesystem::path path_;
  std::unique_ptr<Unfinished> unfinished_;  // a deadline that ends the process removes it too
};

// Returns the program of that name on the PATH; the path is empty where there is none.
std::filesystem::path found_program(const std::string& name);

}  // namespace gld
