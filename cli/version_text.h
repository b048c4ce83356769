#pragma once

#include <string>

namespace gld {

// Returns what gld --version says: "gld 0.1.0, commit 0123abcd, LibTorch 1.13.0". "+" after the commit stands for
// changes that are not committed; the commit is "unknown" where it was built outside of git. Outputs have
// program_version() alone, so that their bytes do not change with a commit.
std::string version_text();

}  // namespace gld
