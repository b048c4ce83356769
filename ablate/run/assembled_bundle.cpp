#include "ablate/run/assembled_bundle.h"

#include "gld/base/atomic_folder.h"
#include "gld/base/sha256.h"
#include "models/bundle/bundle.h"

#include <system_error>

namespace gld {
namespace {

namespace fs = std::filesystem;

// Weight files are replaced, never written into, so that a link cannot change what it is linked to.
void link_or_copy(const fs::path& from, const fs::path& to) {
  std::error_code error;
  fs::create_hard_link(fs::canonical(from), to, error);
  if (error) copy_file_atomically(from, to);
}

}  // namespace

void assemble_bundle(const BundleOptions& options, const fs::path& from, const std::vector<fs::path>& others,
                     const fs::path& to) {
  AtomicFolder folder(to);
  save_bundle_options(folder.temporary(), options);
  const auto assembled = ModelBundle::open(folder.temporary());
  const auto first = ModelBundle::open(from);
  for (const BundlePart& part : bundle_parts(options)) {
    // Named as in every bundle, whatever else these consist of.
    const fs::path name = assembled.file(part).filename();
    const bool has_first = fs::is_regular_file(first.folder() / name);
    const std::string hash_of_first = has_first ? sha256_of_file(first.folder() / name) : "";
    fs::path chosen = has_first ? first.folder() / name : fs::path();
    for (const fs::path& other : others) {
      if (!fs::is_regular_file(other / name)) continue;
      if (sha256_of_file(other / name) != hash_of_first) chosen = other / name;
    }
    if (!chosen.empty()) link_or_copy(chosen, assembled.file(part));
  }
  const fs::path conversion = "conversion.json";
  if (fs::is_regular_file(from / conversion))
    copy_file_atomically(from / conversion, folder.temporary() / conversion);
  folder.commit();
}

}  // namespace gld
