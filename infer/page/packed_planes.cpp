#include "infer/page/packed_planes.h"

#include <algorithm>
#include <cmath>

namespace gld {

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

PackedBox append_positions(std::string& bytes, const std::vector<Eigen::Vector3d>& points) {
  Eigen::Vector3d low = points.front(), high = low;
  for (const Eigen::Vector3d& point : points) {
    low = low.cwiseMin(point);
    high = high.cwiseMax(point);
  }
  // A flat cloud has a box without thickness.
  const double smallest = std::max((high - low).maxCoeff(), 1e-30) / 65535;
  const Eigen::Vector3d step = ((high - low) / 65535).cwiseMax(smallest * 1e-6);
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<uint16_t> values;
    values.reserve(points.size());
    for (const Eigen::Vector3d& point : points) {
      values.push_back(
          static_cast<uint16_t>(std::clamp(std::lround((point[axis] - low[axis]) / step[axis]), 0L, 65535L)));
    }
    append_differences(bytes, values);
  }
  return {low, step, (high - low).norm()};
}

nlohmann::ordered_json vector_json(const Eigen::Vector3d& x) { return {x.x(), x.y(), x.z()}; }

}  // namespace gld
