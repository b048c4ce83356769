#pragma once

#include <filesystem>

namespace gld::test {

// The project's root folder.
std::filesystem::path source_root();

// tests/data: reference cases, scenes and other small files of the tree; its README.md says what they are.
std::filesystem::path test_data();

// The folder of full reference cases and scenes that lies beside a developer's clone: $GLD_SHARED, or ../shared. Only
// tests of the label "shared" may ask for it; they fail where it is missing.
std::filesystem::path shared_data();

}  // namespace gld::test
