#pragma once

#include "models/bundle/bundle_options.h"

#include <filesystem>
#include <vector>

namespace gld {

// Writes a bundle with these options: each of its parts is that of `from`, unless one of `others` has another file of
// it, which a stage trained; then the last of those. Parts that none of them has stay missing. With statistics comes
// the unit of a single source that was measured with them, unless `options` have another than `from`, or `from` has
// these statistics itself: then it is the one that `options` say. Files are linked where the file system can.
void assemble_bundle(const BundleOptions& options, const std::filesystem::path& from,
                     const std::vector<std::filesystem::path>& others, const std::filesystem::path& to);

}  // namespace gld
