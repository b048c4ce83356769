#include "gld/base/user_cache.h"

#include <cstdlib>

namespace gld {
namespace {

// Returns an empty path where the variable is not set or its path is relative.
std::filesystem::path absolute_path_in(const char* variable) {
  const char* value = std::getenv(variable);
  if (value == nullptr) return {};
  const std::filesystem::path path = value;
  return path.is_absolute() ? path : std::filesystem::path();
}

}  // namespace

std::filesystem::path user_cache_folder() {
  const auto cache = absolute_path_in("XDG_CACHE_HOME");
  if (!cache.empty()) return cache / "gld";
  const auto home = absolute_path_in("HOME");
  return home.empty() ? home : home / ".cache" / "gld";
}

}  // namespace gld
