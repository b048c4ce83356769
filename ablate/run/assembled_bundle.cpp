#include "ablate/run/assembled_bundle.h"

#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/sha256.h"
#include "models/bundle/bundle.h"
#include "models/bundle/view_unit_file.h"

#include <algorithm>
#include <string>
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

std::string hash_of(const ModelBundle& bundle, const BundlePart& part) {
  return bundle.has(part) ? sha256_of_file(bundle.file(part)) : "";
}

// Returns the options with the unit that was measured with the statistics which are taken from `others`.
BundleOptions with_measured_unit(BundleOptions options, const ModelBundle& first,
                                 const std::vector<fs::path>& others) {
  const BundleOptions& given = first.options();
  const bool asks_for_another = options.single_source_unit != given.single_source_unit ||
                                options.single_source_unit_deviation != given.single_source_unit_deviation;
  if (asks_for_another) return options;
  const auto parts = bundle_parts(options);
  for (const fs::path& folder : others) {
    const auto other = ModelBundle::open(folder);
    const bool measured = std::any_of(parts.begin(), parts.end(), [&](const BundlePart& part) {
      return part.kind == BundlePart::Kind::kStatistics && other.has(part) &&
             hash_of(other, part) != hash_of(first, part);
    });
    if (!measured) continue;
    options.single_source_unit = other.options().single_source_unit;
    options.single_source_unit_deviation = other.options().single_source_unit_deviation;
  }
  return options;
}

}  // namespace

void assemble_bundle(const BundleOptions& options, const fs::path& from, const std::vector<fs::path>& others,
                     const fs::path& to) {
  AtomicFolder folder(to);
  const auto first = ModelBundle::open(from);
  save_bundle_options(folder.temporary(), with_measured_unit(options, first, others));
  const auto assembled = ModelBundle::open(folder.temporary());
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
  // Of the backbone and head that were chosen, or it counts for nothing.
  std::vector<fs::path> newest_first(others.rbegin(), others.rend());
  newest_first.push_back(from);
  for (const fs::path& other : newest_first) {
    if (!fs::is_regular_file(other / kSingleViewUnitFile)) continue;
    copy_file_atomically(other / kSingleViewUnitFile, folder.temporary() / kSingleViewUnitFile);
    if (read_single_view_unit(assembled) != nullptr) break;
    fs::remove(folder.temporary() / kSingleViewUnitFile);
  }
  const fs::path conversion = "conversion.json";
  if (fs::is_regular_file(from / conversion))
    copy_file_atomically(from / conversion, folder.temporary() / conversion);
  folder.commit();
}

}  // namespace gld
