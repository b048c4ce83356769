#include "infer/pipeline/visible_pairs.h"

#include "models/scene_geometry/geometry_placement.h"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

std::vector<Camera> source_cameras(const Views& views) {
  return {views.cameras.begin(), views.cameras.begin() + static_cast<std::ptrdiff_t>(views.num_sources)};
}

std::vector<PlanarDepth> depth_in_world_units(const torch::Tensor& depth, double unit) {
  std::vector<PlanarDepth> maps;
  const auto scaled = (depth.to(torch::kCPU, torch::kFloat64) * unit).to(torch::kFloat32).contiguous();
  for (int64_t i = 0; i < scaled.size(0); ++i) {
    const auto view = scaled[i];
    const float* first = view.data_ptr<float>();
    maps.push_back({view.size(1), view.size(0), {first, first + view.numel()}});
  }
  return maps;
}

void warn_of_lonely_targets(VisiblePairs& pairs) {
  const auto& lonely = pairs.visibility.lonely_targets;
  if (lonely.empty()) return;
  pairs.warnings.push_back(fmt::format(
      "no source view sees what target view{} {} look{} at; each attends to the nearest source view",
      lonely.size() == 1 ? "" : "s", fmt::join(lonely, ", "), lonely.size() == 1 ? "s" : ""));
}

}  // namespace

torch::Tensor VisiblePairs::view_mask() const {
  if (visibility.all()) return {};
  auto mask = torch::empty({visibility.views, visibility.views}, torch::kBool);
  std::transform(visibility.attends.begin(), visibility.attends.end(), mask.data_ptr<bool>(),
                 [](uint8_t value) { return value != 0; });
  return mask;
}

VisiblePairs visible_pairs(const Views& views) {
  VisiblePairs pairs;
  pairs.visibility = view_visibility(views);
  warn_of_lonely_targets(pairs);
  return pairs;
}

VisiblePairs visible_pairs(const Views& views, const GeometryOutput& source_geometry,
                           const torch::Tensor& photographs) {
  ScaleEvidence evidence;
  evidence.photographs = photographs;
  const GeometryPlacement placement = place_geometry(source_geometry, source_cameras(views), evidence);
  if (!placement.scale) {
    auto pairs = visible_pairs(views);
    pairs.warnings.push_back(fmt::format(
        "view pairs that attend were found from the cameras alone: the depth's unit is not known ({})",
        placement.problem.empty() ? estimates_text(placement.estimates) : placement.problem));
    return pairs;
  }
  VisiblePairs pairs;
  pairs.visibility =
      view_visibility(views, depth_in_world_units(source_geometry.depth, placement.scale->scale));
  warn_of_lonely_targets(pairs);
  return pairs;
}

nlohmann::ordered_json view_pairs_json(const ViewVisibility& visibility) {
  auto rows = nlohmann::ordered_json::array();
  for (int64_t a = 0; a < visibility.views; ++a) {
    auto row = nlohmann::ordered_json::array();
    for (int64_t b = 0; b < visibility.views; ++b) row.push_back(visibility.attends_to(a, b) ? 1 : 0);
    rows.push_back(row);
  }
  return {{"found_from", visibility.used_depth ? "cameras and source depth" : "cameras"},
          {"kept", visibility.kept()},
          {"targets_without_visible_source", visibility.lonely_targets},
          {"attends", rows}};
}

}  // namespace gld
