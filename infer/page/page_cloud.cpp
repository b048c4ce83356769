#include "infer/page/page_cloud.h"

#include "gld/page/page_text.h"
#include "infer/page/packed_planes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

namespace gld {
namespace {

// Footprints are stored as logarithms: the smallest times 2^(k / this).
constexpr double kStepsAnOctave = 16;
// A point may lie so far from the depth of a camera that sees it.
constexpr double kSameSurface = 0.03;

// Returns the length that a pixel of this camera covers at the point; infinite where it lies outside of the picture.
// `seen` is whether the camera's depth there is the point's.
double pixel_length(const SeenDepth& view, const Eigen::Isometry3d& camera_from_world,
                    const Eigen::Vector3d& x_in_world, bool& seen) {
  seen = false;
  const Eigen::Vector3d x = camera_from_world * x_in_world;
  const Camera& camera = view.camera;
  if (!(x.z() > 0)) return std::numeric_limits<double>::infinity();
  const double u =
      (camera.intrinsics(0, 0) * x.x() / x.z() + camera.intrinsics(0, 2)) / static_cast<double>(camera.width);
  const double v = (camera.intrinsics(1, 1) * x.y() / x.z() + camera.intrinsics(1, 2)) /
                   static_cast<double>(camera.height);
  if (!(u >= 0 && u < 1 && v >= 0 && v < 1)) return std::numeric_limits<double>::infinity();
  double wide = static_cast<double>(camera.width), high = static_cast<double>(camera.height);
  if (!view.depth.empty()) {
    wide = static_cast<double>(view.depth.width);
    high = static_cast<double>(view.depth.height);
    const double depth = view.depth.at(std::min(static_cast<int64_t>(u * wide), view.depth.width - 1),
                                       std::min(static_cast<int64_t>(v * high), view.depth.height - 1));
    seen = depth > 0 && std::abs(x.z() / depth - 1) < kSameSurface;
  }
  const double across = x.z() / camera.intrinsics(0, 0) * static_cast<double>(camera.width) / wide;
  const double down = x.z() / camera.intrinsics(1, 1) * static_cast<double>(camera.height) / high;
  return std::max(across, down);
}

std::vector<double> footprints_of(const PointCloud& cloud, const std::vector<SeenDepth>& views, double cell,
                                  double size) {
  std::vector<Eigen::Isometry3d> cameras_from_world;
  cameras_from_world.reserve(views.size());
  for (const SeenDepth& view : views) cameras_from_world.push_back(view.camera.camera_from_world());
  std::vector<double> lengths;
  lengths.reserve(cloud.x_in_world.size());
  for (const Eigen::Vector3d& point : cloud.x_in_world) {
    double of_seen = std::numeric_limits<double>::infinity(), of_all = of_seen;
    for (size_t i = 0; i < views.size(); ++i) {
      bool seen = false;
      const double length = pixel_length(views[i], cameras_from_world[i], point, seen);
      of_all = std::min(of_all, length);
      if (seen) of_seen = std::min(of_seen, length);
    }
    double length = std::isfinite(of_seen) ? of_seen : of_all;
    if (!std::isfinite(length)) length = size / 500;  // no camera has it in its picture
    lengths.push_back(std::max(length, cell));
  }
  return lengths;
}

// Returns the share of all points that are not surer, of 255: to hide those below a share never hides more than it, and
// nothing where all are equally sure.
std::vector<uint8_t> ranks_of(const std::vector<float>& confidences) {
  std::vector<float> sorted = confidences;
  std::sort(sorted.begin(), sorted.end());
  std::vector<uint8_t> ranks;
  ranks.reserve(confidences.size());
  for (const float confidence : confidences) {
    const auto not_surer = std::upper_bound(sorted.begin(), sorted.end(), confidence) - sorted.begin();
    ranks.push_back(static_cast<uint8_t>(255 * not_surer / std::ptrdiff_t(sorted.size())));
  }
  return ranks;
}

}  // namespace

nlohmann::ordered_json page_cloud(PointCloud cloud, const std::vector<SeenDepth>& views,
                                  const Eigen::Vector3d& origin, int64_t most_points) {
  const int64_t all = cloud.size();
  nlohmann::ordered_json json{{"count", 0}, {"of", all}};
  if (all == 0 || most_points == 0) return json;
  const double cell = thin_point_cloud(cloud, most_points);
  const auto count = cloud.x_in_world.size();
  std::string bytes;
  const PackedBox box = append_positions(bytes, cloud.x_in_world);
  for (size_t channel = 0; channel < 3; ++channel) {
    std::vector<uint8_t> values;
    values.reserve(count);
    for (const Rgb& colour : cloud.colours) values.push_back(colour[channel]);
    append_differences(bytes, values);
  }
  const auto lengths = footprints_of(cloud, views, cell, box.diagonal);
  const double shortest = std::max(*std::min_element(lengths.begin(), lengths.end()), 1e-30);
  std::vector<uint8_t> steps;
  steps.reserve(count);
  for (const double length : lengths) {
    steps.push_back(static_cast<uint8_t>(
        std::clamp(std::lround(kStepsAnOctave * std::log2(std::max(length, 1e-30) / shortest)), 0L, 255L)));
  }
  append_differences(bytes, steps);
  append_differences(bytes, ranks_of(cloud.confidences));
  json["count"] = count;
  json["low"] = vector_json(box.low - origin);
  json["step"] = vector_json(box.step);
  json["footprint"] = shortest;
  json["bytes"] = base64_text(deflated(bytes));
  return json;
}

}  // namespace gld
