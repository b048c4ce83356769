#include "gld/photogrammetry/matched_source_depth.h"

#include <fmt/format.h>

namespace gld {

SourceDepth matched_source_depth(const StereoScene& stereo) {
  SourceDepth depth;
  const double confident = stereo.confident_share();
  constexpr double kHardlyAny = 0.01;
  const bool open = stereo.prior ? stereo.prior->pixels == 0 : confident < kHardlyAny;
  if (open) {
    depth.doubt = fmt::format("photographs agree on the depth of {:.1f} % of the source views' pixels",
                              100 * confident);
    return depth;
  }
  for (const StereoDepth& view : stereo.views) depth.views.push_back(view.depth);
  // What photographs confirm is right to a hundredth; what they do not may be off as a prior is, whose scale they gave.
  constexpr double kConfirmed = 0.05, kNotConfirmed = 0.2;
  depth.reach = confident * kConfirmed + (1 - confident) * kNotConfirmed;
  return depth;
}

}  // namespace gld
