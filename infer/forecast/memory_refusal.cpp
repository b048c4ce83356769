#include "infer/forecast/memory_refusal.h"

#include "gld/machine/stage_record.h"
#include "infer/request/sampling_scene.h"

#include <algorithm>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {

std::string memory_refusal(const BundleOptions& bundle, const PlanRequest& request, int64_t available_bytes) {
  const auto peak = [&](const PlanRequest& other) { return plan_sampling(bundle, other).peak_bytes(); };
  const int64_t needed = peak(request);
  if (needed <= available_bytes) return "";
  const auto fits = [&](const PlanRequest& other) { return peak(other) <= available_bytes; };
  // Memory grows with photographs, views and the size, so that the most that fits is found by halving.
  const auto most = [&](int64_t low, int64_t high, const auto& request_of) {
    while (low < high) {
      const int64_t middle = low + (high - low + 1) / 2;
      if (fits(request_of(middle))) {
        low = middle;
      } else {
        high = middle - 1;
      }
    }
    return low;
  };
  const auto with_photographs = [&](int64_t count) {
    PlanRequest other = request;
    other.photographs = count;
    other.num_sources = std::min(request.num_sources, count);
    other.grid.views -= request.num_sources - other.num_sources;
    return other;
  };
  const auto with_all_views = [&](int64_t count) {
    PlanRequest other = request;
    other.grid.views = count;
    return other;
  };
  const auto with_width = [&](int64_t width) {
    PlanRequest other = request;
    other.grid.width = width;
    other.grid.height = std::max<int64_t>(1, request.grid.height * width / request.grid.width);
    // A size that is named has photographs of some 448 pixels a side, whatever they have in the request.
    const int64_t side = bundle.backbone.patch_side() * std::max(other.grid.width, other.grid.height);
    other.photograph_magnification =
        std::min(request.photograph_magnification, std::max<int64_t>(1, kMatchedPhotographSide / side));
    other.picture_magnification = 1;
    return other;
  };
  std::vector<std::string> would_fit;
  if (request.photographs > 1 && fits(with_photographs(1))) {
    would_fit.push_back(fmt::format("{} photographs", most(1, request.photographs - 1, with_photographs)));
  }
  const int64_t fewest = request.num_sources + 1;
  if (request.grid.views > fewest && fits(with_all_views(fewest))) {
    would_fit.push_back(
        fmt::format("{} views of this size", most(fewest, request.grid.views - 1, with_all_views)));
  }
  if (request.grid.width > 1 && fits(with_width(1))) {
    const int64_t widest = request.grid.width - (request.picture_magnification > 1 ? 0 : 1);
    const LatentGrid grid = with_width(most(1, widest, with_width)).grid;
    const int64_t side = bundle.backbone.patch_side();
    would_fit.push_back(
        fmt::format("{} views at --size {}x{}", grid.views, grid.width * side, grid.height * side));
  }
  return fmt::format("This takes {} of memory by the forecast and {} may be taken; {}.", bytes_text(needed),
                     bytes_text(available_bytes),
                     would_fit.empty() ? "no fewer views and no smaller size of this model would fit"
                                       : fmt::format("what would fit: {}", fmt::join(would_fit, ", or ")));
}

}  // namespace gld
