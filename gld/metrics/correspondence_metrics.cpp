#include "gld/metrics/correspondence_metrics.h"

#include "gld/base/error.h"
#include "gld/metrics/feature_sampling.h"
#include "gld/metrics/metric.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <utility>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

constexpr int64_t kStep = 4;  // pixels
constexpr double kReferenceSide = 160;
constexpr int64_t kMostMatches = 1000;
constexpr int64_t kPointsForAMatch = 4;
constexpr int64_t kRowsAtOnce = 512;

struct Points {
  std::vector<Eigen::Vector3d> x_in_world;
  std::vector<Eigen::Vector2d> seen;  // cells of the coarse grid
  torch::Tensor features;             // (points, channels), of length 1
};

Points points_of(const CorrespondenceView& view) {
  if (view.features.dim() != 3 || view.depth.dim() != 2 || view.depth.size(0) != view.camera.height ||
      view.depth.size(1) != view.camera.width) {
    fail({"correspondence", "features (channels, rows, columns) and depth of the camera's size",
          c10::str(view.features.sizes()) + " and " + c10::str(view.depth.sizes()), "resize the depth"});
  }
  const auto depth = view.depth.to(torch::kCPU, torch::kFloat64).contiguous();
  const double* distances = depth.data_ptr<double>();
  const Eigen::Matrix3d rays = view.camera.intrinsics.inverse();
  Points points;
  std::vector<double> places;
  for (int64_t y = 0; y < view.camera.height / kStep; ++y) {
    for (int64_t x = 0; x < view.camera.width / kStep; ++x) {
      const double distance = distances[y * kStep * view.camera.width + x * kStep];
      if (!(std::isfinite(distance) && distance > 0)) continue;
      const Eigen::Vector2d cell(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5);
      const Eigen::Vector2d pixel = cell * static_cast<double>(kStep);
      points.x_in_world.emplace_back(view.camera.world_from_camera * (rays * pixel.homogeneous() * distance));
      points.seen.push_back(cell);
      places.push_back(pixel.x() / static_cast<double>(view.camera.width));
      places.push_back(pixel.y() / static_cast<double>(view.camera.height));
    }
  }
  const auto count = static_cast<int64_t>(points.seen.size());
  points.features = features_at(view.features, torch::tensor(places, torch::kFloat64).view({count, 2}));
  points.features = points.features / points.features.norm(2, 1, /*keepdim=*/true).clamp_min(1e-12);
  return points;
}

// A point's neighbour, and how sure it is.
struct Match {
  int64_t from = 0;
  int64_t to = 0;
  double weight = 0;
};

std::vector<Match> surest_matches(const Points& from, const Points& to) {
  const int64_t count = from.features.size(0);
  std::vector<Match> matches;
  for (int64_t first = 0; first < count; first += kRowsAtOnce) {
    const int64_t rows = std::min(kRowsAtOnce, count - first);
    const auto cosines = torch::matmul(from.features.narrow(0, first, rows), to.features.t());
    const auto [values, places] = cosines.topk(2, 1);
    const auto nearest = values.contiguous();
    const auto where = places.contiguous();
    for (int64_t row = 0; row < rows; ++row) {
      const double d1 = std::max(1 - nearest.data_ptr<double>()[2 * row], 0.0),
                   d2 = std::max(1 - nearest.data_ptr<double>()[2 * row + 1], 0.0);
      matches.push_back({first + row, where.data_ptr<int64_t>()[2 * row], d2 > 0 ? 1 - d1 / d2 : 0});
    }
  }
  std::stable_sort(matches.begin(), matches.end(),
                   [](const Match& a, const Match& b) { return a.weight > b.weight; });
  const int64_t kept = std::min(kMostMatches, std::max<int64_t>(1, count / kPointsForAMatch));
  matches.resize(static_cast<size_t>(std::min<int64_t>(kept, count)));
  return matches;
}

}  // namespace

std::vector<double> correspondence_errors(const CorrespondenceView& from, const CorrespondenceView& to) {
  const Points a = points_of(from), b = points_of(to);
  if (a.seen.size() < 2 || b.seen.size() < 2) return {};
  const Eigen::Isometry3d camera_from_world = to.camera.camera_from_world();
  const double unit = static_cast<double>(std::max(to.camera.width, to.camera.height)) /
                      static_cast<double>(kStep) / kReferenceSide;
  std::vector<double> errors;
  for (const Match& match : surest_matches(a, b)) {
    const Eigen::Vector3d truth =
        to.camera.intrinsics * (camera_from_world * a.x_in_world[static_cast<size_t>(match.from)]);
    errors.push_back(truth.z() > 0 ? (truth.hnormalized() / static_cast<double>(kStep) -
                                      b.seen[static_cast<size_t>(match.to)])
                                             .norm() /
                                         unit
                                   : std::numeric_limits<double>::infinity());
  }
  return errors;
}

double correct_keypoints(const std::vector<double>& errors, double threshold) {
  if (errors.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto right =
      std::count_if(errors.begin(), errors.end(), [&](double error) { return error < threshold; });
  return 100 * static_cast<double>(right) / static_cast<double>(errors.size());
}

namespace {

// The metric is the mean over the pairs of the first view with each other one.
Metric pck_of_level(int64_t level) {
  return {"pck_level" + std::to_string(level),
          "%",
          Better::kHigher,
          {MetricNeed::kTrueLevels, MetricNeed::kAllTrueDepth},
          [level](const MetricInputs& inputs) {
            if (level >= static_cast<int64_t>(inputs.true_levels.size())) {
              return absent_metric("the backbone has no level " + std::to_string(level));
            }
            const auto& features = inputs.true_levels[static_cast<size_t>(level)];
            const auto view_of = [&](int64_t view) {
              return CorrespondenceView{features[view], inputs.all_true_depth[view],
                                        inputs.views.cameras[static_cast<size_t>(view)]};
            };
            std::vector<double> shares;
            for (int64_t other = 1; other < inputs.views.size(); ++other) {
              const double share = correct_keypoints(correspondence_errors(view_of(0), view_of(other)));
              if (!std::isnan(share)) shares.push_back(share);
            }
            if (shares.empty()) return absent_metric("no pair of views has points with known depth");
            const double mean =
                std::accumulate(shares.begin(), shares.end(), 0.0) / static_cast<double>(shares.size());
            return metric_of_views(torch::full({1}, mean, torch::kFloat64), "it is not a number");
          }};
}

}  // namespace

std::vector<Metric> correspondence_metrics() { return metrics_of_levels(pck_of_level); }

}  // namespace gld
