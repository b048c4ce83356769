#include "infer/pipeline/visible_pairs.h"

#include "gld/base/error.h"
#include "gld/cameras/pose_alignment.h"
#include "infer/pipeline/predicted_cameras.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

// Predicted cameras that fit worse than this do not tell the depth's unit well enough: degrees, and a share of the root
// mean square distance of the source views from their middle.
constexpr double kLargestTurn = 15;
constexpr double kLargestCentreError = 0.3;

std::vector<Camera> source_cameras(const Views& views) {
  return {views.cameras.begin(), views.cameras.begin() + static_cast<std::ptrdiff_t>(views.num_sources)};
}

double spread(const std::vector<Camera>& cameras) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Camera& camera : cameras) middle += camera.world_from_camera.translation();
  middle /= static_cast<double>(cameras.size());
  double square = 0;
  for (const Camera& camera : cameras)
    square += (camera.world_from_camera.translation() - middle).squaredNorm();
  return std::sqrt(square / static_cast<double>(cameras.size()));
}

// The length in the world of one unit of the DPT head's depth. Throws Error where it is not known.
double depth_unit(const Views& views, const GeometryOutput& geometry) {
  const auto fail_with = [](const std::string& found) {
    fail({"source depth", "predicted cameras that fit the given ones", found, "the cameras alone decide"});
  };
  const auto given = source_cameras(views);
  const auto alignment = align_poses(predicted_cameras(geometry, given), given);
  if (!alignment.scale_known) fail_with("cameras that do not tell its unit");
  if (alignment.rotation_error > kLargestTurn) {
    fail_with(fmt::format("cameras turned by {:.0f} degrees", alignment.rotation_error));
  }
  if (alignment.centre_error > kLargestCentreError * spread(given)) {
    fail_with(
        fmt::format("centres off by {:.0f} % of their spread", 100 * alignment.centre_error / spread(given)));
  }
  return alignment.b_from_a.scale;
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

VisiblePairs visible_pairs(const Views& views, const GeometryOutput& source_geometry) {
  double unit = 0;
  try {
    unit = depth_unit(views, source_geometry);
  } catch (const Error& error) {
    auto pairs = visible_pairs(views);
    pairs.warnings.push_back(fmt::format(
        "view pairs that attend were found from the cameras alone: the depth's unit is not known ({})",
        error.parts().found));
    return pairs;
  }
  VisiblePairs pairs;
  pairs.visibility = view_visibility(views, depth_in_world_units(source_geometry.depth, unit));
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
