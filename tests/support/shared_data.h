#pragma once

#include <filesystem>
#include <functional>
#include <string>

namespace gld::test {

// The folder of reference tensors and scenes: $GLD_SHARED, or ../shared beside the project. A test that needs it and
// does not find it fails.
std::filesystem::path shared_data();

// The project's root folder.
std::filesystem::path source_root();

// A fresh empty folder, removed when the object goes.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

// what() of the gld::Error that action throws; fails the test when it throws nothing.
std::string error_of(const std::function<void()>& action);

}  // namespace gld::test
