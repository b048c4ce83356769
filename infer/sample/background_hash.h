#pragma once

#include "models/bundle/bundle.h"

#include <future>
#include <string>

namespace gld {

// Computes a bundle's content hash beside other work: at full size it reads gigabytes, and nothing needs it before the
// first output is written.
class BackgroundHash {
 public:
  explicit BackgroundHash(const ModelBundle& bundle);
  // Waits for it. Throws Error where a file cannot be read.
  const std::string& get();

 private:
  std::future<std::string> running_;
  std::string hash_;
};

}  // namespace gld
