#pragma once

#include <filesystem>

namespace gld::test {

// Returns the project's root folder.
std::filesystem::path source_root();

// Returns tests/data, which has reference cases, scenes and other small files of the tree; its README.md says what they
// are.
std::filesystem::path test_data();

// Returns the folder of full reference cases and scenes that lies beside a developer's clone: $GLD_SHARED, or
// ../shared. Only tests of the label "shared" may ask for it; they fail where it is missing.
std::filesystem::path shared_data();

}  // namespace gld::test
