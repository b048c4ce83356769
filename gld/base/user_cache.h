#pragma once

#include <filesystem>

namespace gld {

// This program's folder among the user's caches: gld in XDG_CACHE_HOME, or in .cache below HOME (XDG Base Directory
// Specification: a relative path in the variable does not count). Empty where neither is set. It need not exist. The
// only place that reads the environment.
std::filesystem::path user_cache_folder();

}  // namespace gld
