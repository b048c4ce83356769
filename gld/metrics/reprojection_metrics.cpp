#include "gld/metrics/reprojection_metrics.h"

#include "gld/base/error.h"
#include "gld/metrics/metric.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <tuple>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

constexpr double kDepthAgreement = 0.05;  // relative

void require_depth_of_cameras(const torch::Tensor& depth, const std::vector<Camera>& cameras) {
  bool fits = depth.dim() == 3 && depth.size(0) == static_cast<int64_t>(cameras.size());
  for (const Camera& camera : cameras) {
    fits = fits && camera.height == depth.size(1) && camera.width == depth.size(2);
  }
  if (fits) return;
  fail({"reprojection", "a depth map (views, height, width) of each camera's size",
        c10::str(depth.sizes()) + " for " + std::to_string(cameras.size()) + " cameras",
        "resize the depth to the cameras"});
}

bool is_known(double depth) { return std::isfinite(depth) && depth > 0; }

// A view's depth as a surface.
class DepthSurface {
 public:
  // depth is (height, width) doubles, which must outlive this object.
  DepthSurface(const double* depth, const Camera& camera)
      : depth_(depth),
        camera_(camera),
        rays_(camera.intrinsics.inverse()),
        camera_from_world_(camera.camera_from_world()) {}

  double at(int64_t x, int64_t y) const { return depth_[y * camera_.width + x]; }
  Eigen::Vector3d lifted(double u, double v, double depth) const {
    return camera_.world_from_camera * (rays_ * Eigen::Vector3d(u, v, 1) * depth);
  }
  // Returns (u, v, depth), and nothing behind the camera or outside the picture.
  std::optional<Eigen::Vector3d> seen(const Eigen::Vector3d& x_in_world) const {
    const Eigen::Vector3d x = camera_.intrinsics * (camera_from_world_ * x_in_world);
    const double u = x.x() / x.z(), v = x.y() / x.z();
    if (!(x.z() > 0 && u >= 0 && v >= 0 && u < static_cast<double>(camera_.width) &&
          v < static_cast<double>(camera_.height))) {
      return std::nullopt;
    }
    return Eigen::Vector3d(u, v, x.z());
  }
  // Returns the depth between the middles of pixels, linear in 1 / depth, and 0 where one of them is not known. A pixel
  // at the rim has no neighbour there: its inverse depth goes on in the direction of the other side's.
  double between(double u, double v) const {
    const auto last_x = std::max<int64_t>(camera_.width - 2, 0),
               last_y = std::max<int64_t>(camera_.height - 2, 0);
    const auto x = std::clamp(static_cast<int64_t>(std::floor(u - 0.5)), int64_t{0}, last_x);
    const auto y = std::clamp(static_cast<int64_t>(std::floor(v - 0.5)), int64_t{0}, last_y);
    const int64_t next_x = std::min(x + 1, camera_.width - 1), next_y = std::min(y + 1, camera_.height - 1);
    const double right = u - 0.5 - static_cast<double>(x), below = v - 0.5 - static_cast<double>(y);
    double inverse = 0;
    for (const auto& [column, row, weight] :
         {std::tuple(x, y, (1 - right) * (1 - below)), std::tuple(next_x, y, right * (1 - below)),
          std::tuple(x, next_y, (1 - right) * below), std::tuple(next_x, next_y, right * below)}) {
      const double depth = at(column, row);
      if (!is_known(depth)) return 0;
      inverse += weight / depth;
    }
    return inverse > 0 ? 1 / inverse : 0;
  }
  int64_t width() const { return camera_.width; }
  int64_t height() const { return camera_.height; }

 private:
  const double* depth_;
  const Camera& camera_;
  Eigen::Matrix3d rays_;
  Eigen::Isometry3d camera_from_world_;
};

}  // namespace

namespace {

double centre_spread(const std::vector<Camera>& cameras) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  const auto count = static_cast<double>(cameras.size());
  for (const Camera& camera : cameras) mean += camera.world_from_camera.translation() / count;
  double squares = 0;
  for (const Camera& camera : cameras)
    squares += (camera.world_from_camera.translation() - mean).squaredNorm();
  return std::sqrt(squares / count);
}

// Returns NaN without a known pixel.
double median_known_depth(const torch::Tensor& depth) {
  const auto values = depth.to(torch::kCPU, torch::kFloat64);
  const auto known = values.masked_select(values.isfinite() & (values > 0));
  return known.numel() > 0 ? known.median().item<double>() : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

double baseline_ratio(const std::vector<Camera>& cameras, const torch::Tensor& depth,
                      const std::vector<Camera>& true_cameras, const torch::Tensor& true_depth) {
  const double truth = centre_spread(true_cameras) / median_known_depth(true_depth);
  if (!(truth > 0)) return std::numeric_limits<double>::quiet_NaN();
  return centre_spread(cameras) / median_known_depth(depth) / truth;
}

std::vector<ColouredPoint> coloured_points(const torch::Tensor& images, const torch::Tensor& depth,
                                           const std::vector<Camera>& cameras) {
  require_depth_of_cameras(depth, cameras);
  if (images.dim() != 4 || images.size(1) != 3 || images.size(0) != depth.size(0) ||
      images.size(2) != depth.size(1) || images.size(3) != depth.size(2)) {
    fail({"reprojection", "images (views, 3, height, width) of the depth's size", c10::str(images.sizes()),
          "resize the images"});
  }
  const auto maps = depth.to(torch::kCPU, torch::kFloat64).contiguous();
  const auto colours = (images.to(torch::kCPU, torch::kFloat64).clamp(0, 1) * 255)
                           .round()
                           .to(torch::kUInt8)
                           .permute({0, 2, 3, 1})
                           .contiguous();
  const auto* rgb = colours.data_ptr<uint8_t>();
  std::vector<ColouredPoint> points;
  points.reserve(static_cast<size_t>(depth.numel()));
  const int64_t pixels = depth.size(1) * depth.size(2);
  for (int64_t view = 0; view < depth.size(0); ++view) {
    const DepthSurface surface(maps.data_ptr<double>() + view * pixels, cameras[static_cast<size_t>(view)]);
    for (int64_t y = 0; y < surface.height(); ++y) {
      for (int64_t x = 0; x < surface.width(); ++x) {
        const double distance = surface.at(x, y);
        if (!is_known(distance)) continue;
        const uint8_t* colour = rgb + 3 * (view * pixels + y * surface.width() + x);
        points.push_back(
            {surface.lifted(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, distance),
             {colour[0], colour[1], colour[2]}});
      }
    }
  }
  return points;
}

torch::Tensor painted_cloud(const std::vector<ColouredPoint>& points, const Camera& camera) {
  auto image = torch::zeros({3, camera.height, camera.width}, torch::kFloat64);
  std::vector<double> nearest(static_cast<size_t>(camera.height * camera.width),
                              std::numeric_limits<double>::infinity());
  auto* pixels = image.data_ptr<double>();
  const int64_t plane = camera.height * camera.width;
  const Eigen::Isometry3d camera_from_world = camera.camera_from_world();
  for (const ColouredPoint& point : points) {
    const Eigen::Vector3d x = camera.intrinsics * (camera_from_world * point.x_in_world);
    const double u = x.x() / x.z(), v = x.y() / x.z();
    if (!(x.z() > 0 && u >= 0 && v >= 0 && u < static_cast<double>(camera.width) &&
          v < static_cast<double>(camera.height))) {
      continue;
    }
    const int64_t pixel = static_cast<int64_t>(v) * camera.width + static_cast<int64_t>(u);
    double& depth = nearest[static_cast<size_t>(pixel)];
    if (x.z() > depth) continue;
    depth = x.z();
    for (int64_t channel = 0; channel < 3; ++channel) {
      pixels[channel * plane + pixel] = point.rgb[static_cast<size_t>(channel)] / 255.0;
    }
  }
  return image;
}

RoundTrip depth_round_trip(const torch::Tensor& depth, const std::vector<Camera>& cameras) {
  require_depth_of_cameras(depth, cameras);
  const auto maps = depth.to(torch::kCPU, torch::kFloat64).contiguous();
  const int64_t pixels = depth.size(1) * depth.size(2);
  std::vector<DepthSurface> surfaces;
  for (size_t view = 0; view < cameras.size(); ++view) {
    surfaces.emplace_back(maps.data_ptr<double>() + static_cast<int64_t>(view) * pixels, cameras[view]);
  }
  double distances = 0;
  int64_t back = 0, agreeing = 0, compared = 0;
  for (size_t i = 0; i < surfaces.size(); ++i) {
    for (size_t j = 0; j < surfaces.size(); ++j) {
      if (i == j) continue;
      for (int64_t y = 0; y < surfaces[i].height(); ++y) {
        for (int64_t x = 0; x < surfaces[i].width(); ++x) {
          const double distance = surfaces[i].at(x, y);
          if (!is_known(distance)) continue;
          const double u = static_cast<double>(x) + 0.5, v = static_cast<double>(y) + 0.5;
          const auto there = surfaces[j].seen(surfaces[i].lifted(u, v, distance));
          if (!there) continue;
          const double depth_there = surfaces[j].between(there->x(), there->y());
          if (!is_known(depth_there)) continue;
          ++compared;
          if (std::abs(depth_there - there->z()) > kDepthAgreement * there->z()) continue;
          ++agreeing;
          const auto again = surfaces[i].seen(surfaces[j].lifted(there->x(), there->y(), depth_there));
          if (!again) continue;
          distances += (again->head<2>() - Eigen::Vector2d(u, v)).norm();
          ++back;
        }
      }
    }
  }
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  return {back > 0 ? distances / static_cast<double>(back) : kNone,
          compared > 0 ? static_cast<double>(agreeing) / static_cast<double>(compared) : kNone};
}

namespace {

// Each view's picture beside the cloud of all drawn into it.
struct Rerendering {
  torch::Tensor frames;   // (views, 3, height, width), in steps of 1/255
  torch::Tensor renders;  // of the same shape
};

Rerendering rerendering(const MetricInputs& inputs) {
  const auto points = coloured_points(inputs.view_images, inputs.view_depth, inputs.estimated_cameras);
  std::vector<torch::Tensor> renders;
  for (const Camera& camera : inputs.estimated_cameras) renders.push_back(painted_cloud(points, camera));
  return {(inputs.view_images.to(torch::kCPU, torch::kFloat64).clamp(0, 1) * 255).round() / 255,
          torch::stack(renders)};
}

torch::Tensor rerender_mse(const Rerendering& both) {
  return (both.frames - both.renders).square().mean({1, 2, 3});
}

torch::Tensor rerender_distance(const Rerendering& both, const MetricInputs& inputs) {
  return inputs.perceptual_distance(both.frames.to(torch::kFloat32), both.renders.to(torch::kFloat32))
      .to(torch::kCPU, torch::kFloat64);
}

// The value is of all views together: sources and targets are drawn into each other.
MetricValue of_all_views(const torch::Tensor& per_view) {
  return metric_of_views(per_view.mean().reshape({1}), "the pictures are not finite");
}

Metric round_trip_metric(const std::string& name, const std::string& unit, Better better,
                         double RoundTrip::*number) {
  return {name, unit, better, {MetricNeed::kViewGeometry}, [=](const MetricInputs& inputs) {
            const RoundTrip found = depth_round_trip(inputs.view_depth, inputs.estimated_cameras);
            return metric_of_views(torch::full({1}, found.*number, torch::kFloat64),
                                   "no pixel of a view is seen in another one");
          }};
}

Metric reprojection_mse_metric() {
  return {
      "reprojection_mse", "", Better::kLower, {MetricNeed::kViewGeometry}, [](const MetricInputs& inputs) {
        return of_all_views(rerender_mse(rerendering(inputs)));
      }};
}

Metric reprojection_perceptual_metric() {
  return {"reprojection_perceptual",
          "",
          Better::kLower,
          {MetricNeed::kViewGeometry, MetricNeed::kPerceptualDistance},
          [](const MetricInputs& inputs) {
            return of_all_views(rerender_distance(rerendering(inputs), inputs));
          }};
}

// VideoGPA's score with its released ratio of 1.
Metric reprojection_score_metric() {
  return {"reprojection_score",
          "",
          Better::kLower,
          {MetricNeed::kViewGeometry, MetricNeed::kPerceptualDistance},
          [](const MetricInputs& inputs) {
            const Rerendering both = rerendering(inputs);
            return of_all_views(rerender_mse(both) + rerender_distance(both, inputs));
          }};
}

Metric reprojection_pixels_metric() {
  return round_trip_metric("reprojection_pixels", "pixels", Better::kLower, &RoundTrip::pixels);
}

Metric reprojection_baseline_ratio_metric() {
  return {"reprojection_baseline_ratio",
          "",
          Better::kNearOne,
          {MetricNeed::kViewGeometry, MetricNeed::kAllTrueDepth},
          [](const MetricInputs& inputs) {
            const double ratio = baseline_ratio(inputs.estimated_cameras, inputs.view_depth,
                                                inputs.views.cameras, inputs.all_true_depth);
            return metric_of_views(torch::full({1}, ratio, torch::kFloat64),
                                   "the scene's cameras stand at one place, or no depth is known");
          }};
}

Metric reprojection_agreement_metric() {
  return round_trip_metric("reprojection_agreement", "", Better::kHigher, &RoundTrip::agreement);
}

}  // namespace

std::vector<Metric> reprojection_metrics() {
  return {reprojection_mse_metric(),       reprojection_perceptual_metric(),
          reprojection_score_metric(),     reprojection_pixels_metric(),
          reprojection_agreement_metric(), reprojection_baseline_ratio_metric()};
}

}  // namespace gld
