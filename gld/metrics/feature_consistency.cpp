#include "gld/metrics/feature_consistency.h"

#include "gld/base/error.h"
#include "gld/metrics/feature_sampling.h"
#include "gld/metrics/metric.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

constexpr double kSmall = 1e-5;          // in the cosine and beside the mask's sum, as published
constexpr int64_t kPixelsAtOnce = 4096;  // of 1536 channels in double: 50 MB

// Pixels of the first view, and those of the other one whose points cover them.
struct Coverage {
  std::vector<int64_t> pixels;
  std::vector<int64_t> of_other;
  int64_t known = 0;  // pixels of the first view with known depth
};

void require_depth_of_camera(const FeatureView& view) {
  if (view.features.dim() == 3 && view.depth.dim() == 2 && view.depth.size(0) == view.camera.height &&
      view.depth.size(1) == view.camera.width) {
    return;
  }
  fail({"consistency of features", "features (channels, rows, columns) and depth of the camera's size",
        c10::str(view.features.sizes()) + " and " + c10::str(view.depth.sizes()), "resize the depth"});
}

Coverage coverage_of(const FeatureView& first, const FeatureView& other) {
  const auto depth = other.depth.to(torch::kCPU, torch::kFloat64).contiguous();
  const auto own = first.depth.to(torch::kCPU, torch::kFloat64).contiguous();
  const double* distances = depth.data_ptr<double>();
  const double* known = own.data_ptr<double>();
  const Camera &to = first.camera, &from = other.camera;
  const Eigen::Matrix3d rays = from.intrinsics.inverse();
  const Eigen::Isometry3d to_from_from = to.camera_from_world() * from.world_from_camera;
  const auto pixels = static_cast<size_t>(to.height * to.width);
  std::vector<double> nearest(pixels, std::numeric_limits<double>::infinity());
  std::vector<int64_t> covering(pixels, -1);
  for (int64_t y = 0; y < from.height; ++y) {
    for (int64_t x = 0; x < from.width; ++x) {
      const int64_t cell = y * from.width + x;
      if (!(std::isfinite(distances[cell]) && distances[cell] > 0)) continue;
      const Eigen::Vector3d ray =
          rays * Eigen::Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1);
      const Eigen::Vector3d seen = to.intrinsics * (to_from_from * (ray * distances[cell]));
      const double u = seen.x() / seen.z(), v = seen.y() / seen.z();
      if (!(seen.z() > 0 && u >= 0 && v >= 0 && u < static_cast<double>(to.width) &&
            v < static_cast<double>(to.height))) {
        continue;
      }
      const auto pixel = static_cast<size_t>(static_cast<int64_t>(v) * to.width + static_cast<int64_t>(u));
      if (seen.z() > nearest[pixel]) continue;
      nearest[pixel] = seen.z();
      covering[pixel] = cell;
    }
  }
  Coverage result;
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    if (!(std::isfinite(known[pixel]) && known[pixel] > 0)) continue;
    ++result.known;
    if (covering[pixel] < 0) continue;
    result.pixels.push_back(static_cast<int64_t>(pixel));
    result.of_other.push_back(covering[pixel]);
  }
  return result;
}

// Returns the middles of pixels as shares of the picture, (count, 2).
torch::Tensor middles(const std::vector<int64_t>& pixels, size_t first, size_t count, const Camera& camera) {
  auto places = torch::empty({static_cast<int64_t>(count), 2}, torch::kFloat64);
  auto* place = places.data_ptr<double>();
  for (size_t i = 0; i < count; ++i) {
    const int64_t pixel = pixels[first + i];
    const int64_t row = pixel / camera.width, column = pixel % camera.width;
    place[2 * i] = (static_cast<double>(column) + 0.5) / static_cast<double>(camera.width);
    place[2 * i + 1] = (static_cast<double>(row) + 0.5) / static_cast<double>(camera.height);
  }
  return places;
}

}  // namespace

FeatureConsistency feature_consistency(const FeatureView& first, const FeatureView& other) {
  require_depth_of_camera(first);
  require_depth_of_camera(other);
  const Coverage covered = coverage_of(first, other);
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  if (covered.known == 0) return {kNone, kNone};
  if (covered.pixels.empty()) return {kNone, 0};
  double sum = 0;
  const auto step = static_cast<size_t>(kPixelsAtOnce);
  for (size_t start = 0; start < covered.pixels.size(); start += step) {
    const size_t count = std::min(step, covered.pixels.size() - start);
    const auto a = features_at(first.features, middles(covered.pixels, start, count, first.camera));
    const auto b = features_at(other.features, middles(covered.of_other, start, count, other.camera));
    const auto lengths = (a.norm(2, 1) * b.norm(2, 1)).clamp_min(kSmall);
    sum += (1 - (a * b).sum(1) / lengths).sum().item<double>();
  }
  const auto count = static_cast<double>(covered.pixels.size());
  return {sum / (count + kSmall), count / static_cast<double>(covered.known)};
}

namespace {

// Each target is compared with the view whose camera stands nearest to it in the scene.
int64_t nearest_view(const Views& views, int64_t target) {
  int64_t nearest = -1;
  double least = std::numeric_limits<double>::infinity();
  const auto centre = [&](int64_t view) {
    return Eigen::Vector3d(views.cameras[static_cast<size_t>(view)].world_from_camera.translation());
  };
  for (int64_t view = 0; view < views.size(); ++view) {
    const double distance = (centre(view) - centre(target)).norm();
    if (view == target || distance >= least) continue;
    least = distance;
    nearest = view;
  }
  return nearest;
}

enum class ConsistencyGeometry { kPredicted, kTrue };
enum class ConsistentPictures { kPredicted, kTrue };

Metric consistency_metric(const std::string& name, Better better, ConsistentPictures pictures,
                          ConsistencyGeometry geometry, double FeatureConsistency::*number) {
  const bool of_truth = pictures == ConsistentPictures::kTrue;
  Metric metric{
      name, "", better, {of_truth ? MetricNeed::kTrueFeatures : MetricNeed::kViewFeatures}, nullptr};
  const bool predicted = geometry == ConsistencyGeometry::kPredicted;
  metric.needs.push_back(predicted ? MetricNeed::kViewGeometry : MetricNeed::kAllTrueDepth);
  metric.compute = [=](const MetricInputs& inputs) {
    const auto& cameras = predicted ? inputs.estimated_cameras : inputs.views.cameras;
    const auto& depth = predicted ? inputs.view_depth : inputs.all_true_depth;
    const auto& features = of_truth ? inputs.true_features : inputs.view_features;
    const auto view_of = [&](int64_t view) {
      return FeatureView{features[view], depth[view], cameras[static_cast<size_t>(view)]};
    };
    const Views& views = inputs.views;
    auto per_target =
        torch::full({views.num_targets()}, std::numeric_limits<double>::quiet_NaN(), torch::kFloat64);
    for (int64_t target = views.num_sources; target < views.size(); ++target) {
      const int64_t other = nearest_view(views, target);
      if (other < 0) continue;
      per_target[target - views.num_sources] = feature_consistency(view_of(target), view_of(other)).*number;
    }
    return metric_of_views(per_target, "no view covers another one");
  };
  return metric;
}

}  // namespace

std::vector<Metric> feature_consistency_metrics() {
  return {consistency_metric("met3r_like", Better::kLower, ConsistentPictures::kPredicted,
                             ConsistencyGeometry::kPredicted, &FeatureConsistency::distance),
          consistency_metric("met3r_like_coverage", Better::kHigher, ConsistentPictures::kPredicted,
                             ConsistencyGeometry::kPredicted, &FeatureConsistency::coverage),
          consistency_metric("met3r_like_true_geometry", Better::kLower, ConsistentPictures::kPredicted,
                             ConsistencyGeometry::kTrue, &FeatureConsistency::distance),
          consistency_metric("met3r_like_of_truth", Better::kLower, ConsistentPictures::kTrue,
                             ConsistencyGeometry::kTrue, &FeatureConsistency::distance)};
}

}  // namespace gld
