#pragma once

#include <filesystem>

namespace gld {

// Returns this program's folder among the user's caches: gld in XDG_CACHE_HOME, or in .cache below HOME (XDG Base
// Directory Specification: a relative path in the variable does not count). The path is empty where neither is set. The
// folder need not exist.
std::filesystem::path user_cache_folder();

}  // namespace gld
