#include "infer/page/page_cloud.h"

#include "gld/page/page_text.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

namespace gld {
namespace {

// Footprints are stored as logarithms: the smallest times 2^(k / this).
constexpr double kStepsAnOctave = 16;
// How far a point may lie from the depth of a camera that sees it.
constexpr double kSameSurface = 0.03;

// The length that a pixel of this camera covers at the point; infinite where it lies outside of the picture. `seen` is
// whether the camera's depth there is the point's.
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

// The share of all points that are not surer, of 255: to hide those below a share never hides more than it, and nothing
// where all are equally sure.
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

// Neighbours in a row of a view are neighbours in the cloud: differences of 16 bits, small ones of both signs as small
// numbers, the low bytes of all of them and then the high ones.
void append_differences(std::string& bytes, const std::vector<uint16_t>& values) {
  std::string high;
  uint16_t before = 0;
  for (const uint16_t value : values) {
    const auto difference = static_cast<int16_t>(static_cast<uint16_t>(value - before));
    const auto folded = static_cast<uint16_t>(difference < 0 ? -2 * (difference + 1) + 1 : 2 * difference);
    bytes.push_back(static_cast<char>(folded & 255));
    high.push_back(static_cast<char>(folded >> 8));
    before = value;
  }
  bytes += high;
}

void append_differences(std::string& bytes, const std::vector<uint8_t>& values) {
  uint8_t before = 0;
  for (const uint8_t value : values) {
    bytes.push_back(static_cast<char>(static_cast<uint8_t>(value - before)));
    before = value;
  }
}

nlohmann::ordered_json list_of(const Eigen::Vector3d& x) { return {x.x(), x.y(), x.z()}; }

}  // namespace

nlohmann::ordered_json page_cloud(PointCloud cloud, const std::vector<SeenDepth>& views,
                                  const Eigen::Vector3d& origin, int64_t most_points) {
  const int64_t all = cloud.size();
  nlohmann::ordered_json json{{"count", 0}, {"of", all}};
  if (all == 0 || most_points == 0) return json;
  const double cell = thin_point_cloud(cloud, most_points);
  Eigen::Vector3d low = cloud.x_in_world.front(), high = low;
  for (const Eigen::Vector3d& point : cloud.x_in_world) {
    low = low.cwiseMin(point);
    high = high.cwiseMax(point);
  }
  // A flat cloud has a box without thickness.
  const double smallest = std::max((high - low).maxCoeff(), 1e-30) / 65535;
  const Eigen::Vector3d step = ((high - low) / 65535).cwiseMax(smallest * 1e-6);
  const auto count = cloud.x_in_world.size();
  std::string bytes;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<uint16_t> values;
    values.reserve(count);
    for (const Eigen::Vector3d& point : cloud.x_in_world) {
      values.push_back(
          static_cast<uint16_t>(std::clamp(std::lround((point[axis] - low[axis]) / step[axis]), 0L, 65535L)));
    }
    append_differences(bytes, values);
  }
  for (size_t channel = 0; channel < 3; ++channel) {
    std::vector<uint8_t> values;
    values.reserve(count);
    for (const Rgb& colour : cloud.colours) values.push_back(colour[channel]);
    append_differences(bytes, values);
  }
  const auto lengths = footprints_of(cloud, views, cell, (high - low).norm());
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
  json["low"] = list_of(low - origin);
  json["step"] = list_of(step);
  json["footprint"] = shortest;
  json["bytes"] = base64_text(deflated(bytes));
  return json;
}

}  // namespace gld
