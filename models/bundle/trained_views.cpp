#include "models/bundle/trained_views.h"

#include "gld/files/weight_file.h"
#include "models/bundle/part_lineage.h"

#include <algorithm>
#include <charconv>
#include <string>

namespace gld {
namespace {

constexpr const char* kTrainedViews = "gld:trained_views";

}  // namespace

void note_trained_views(const ModelBundle& bundle, const BundlePart& part, int64_t views) {
  note_in_metadata(bundle, part, {{kTrainedViews, std::to_string(views)}});
}

int64_t trained_views(const ModelBundle& bundle) {
  int64_t fewest = 0;
  for (const BundlePart& part : bundle_parts(bundle.options())) {
    if (part.kind != BundlePart::Kind::kGenerator || !bundle.has(part)) continue;
    const auto file = WeightFile::open(bundle.file(part));
    const auto noted = file->metadata().find(kTrainedViews);
    if (noted == file->metadata().end()) continue;
    int64_t views = 0;
    const char* const end = noted->second.data() + noted->second.size();
    const auto parsed = std::from_chars(noted->second.data(), end, views);
    if (parsed.ec != std::errc() || parsed.ptr != end || views < 1) continue;  // another program's
    fewest = fewest == 0 ? views : std::min(fewest, views);
  }
  return fewest;
}

}  // namespace gld
