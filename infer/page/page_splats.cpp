#include "infer/page/page_splats.h"

#include "gld/page/page_text.h"
#include "gld/splatting/spherical_harmonics.h"
#include "infer/page/packed_planes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <string>
#include <vector>

namespace gld {
namespace {

// Beyond e^18 two axes of one scene are a needle without width, or a fog.
constexpr double kLongestScaleRange = 18;

double opacity_of(const GaussianSet& set, size_t i) {
  return 1 / (1 + std::exp(-static_cast<double>(set.logit_opacities[i])));
}

// Returns those that cover most, in the set's order.
std::vector<size_t> chosen_gaussians(const GaussianSet& set, int64_t most) {
  std::vector<size_t> all(static_cast<size_t>(set.size()));
  std::iota(all.begin(), all.end(), size_t{0});
  if (set.size() <= most) return all;
  std::vector<double> covered;
  for (const size_t i : all) {
    std::array<float, 3> axes{set.log_scales[3 * i], set.log_scales[3 * i + 1], set.log_scales[3 * i + 2]};
    std::sort(axes.begin(), axes.end());
    covered.push_back(std::log(opacity_of(set, i)) + axes[1] + axes[2]);
  }
  std::stable_sort(all.begin(), all.end(), [&](size_t a, size_t b) { return covered[a] > covered[b]; });
  all.resize(static_cast<size_t>(most));
  std::sort(all.begin(), all.end());
  return all;
}

uint8_t byte_of(double value) { return static_cast<uint8_t>(std::clamp(std::lround(value), 0L, 255L)); }

// Returns the same rotation with length 1 and the real part not negative.
std::array<double, 4> unit_rotation(const GaussianSet& set, size_t i) {
  std::array<double, 4> q{};
  double length = 0;
  for (size_t k = 0; k < 4; ++k) {
    q[k] = set.rotations[4 * i + k];
    length += q[k] * q[k];
  }
  length = std::sqrt(length) * (q[0] < 0 ? -1 : 1);
  for (double& value : q) value /= length;
  return q;
}

}  // namespace

nlohmann::ordered_json page_splats(const GaussianSet& set, const Eigen::Vector3d& origin, int64_t most) {
  nlohmann::ordered_json json{{"count", 0}, {"of", set.size()}};
  const std::vector<size_t> chosen = chosen_gaussians(set, most);
  if (chosen.empty()) return json;
  std::string bytes;
  std::vector<Eigen::Vector3d> means;
  double low = set.log_scales[3 * chosen.front()], high = low;
  for (const size_t i : chosen) {
    means.push_back(set.mean_in_world(i));
    for (size_t axis = 0; axis < 3; ++axis) {
      low = std::min<double>(low, set.log_scales[3 * i + axis]);
      high = std::max<double>(high, set.log_scales[3 * i + axis]);
    }
  }
  const PackedBox box = append_positions(bytes, means);
  low = std::max(low, high - kLongestScaleRange);
  const double step = std::max((high - low) / 255, 1e-6);
  const auto append = [&](const auto& value_of) {
    std::vector<uint8_t> values;
    values.reserve(chosen.size());
    for (const size_t i : chosen) values.push_back(byte_of(value_of(i)));
    append_differences(bytes, values);
  };
  for (size_t axis = 0; axis < 3; ++axis) {
    append([&](size_t i) { return (set.log_scales[3 * i + axis] - low) / step; });
  }
  for (size_t k = 0; k < 4; ++k) append([&](size_t i) { return 128 + 127 * unit_rotation(set, i)[k]; });
  for (size_t channel = 0; channel < 3; ++channel) {
    append([&](size_t i) { return 255 * colour_of_coefficient(set.colours[3 * i + channel]); });
  }
  append([&](size_t i) { return 255 * opacity_of(set, i); });
  json["count"] = chosen.size();
  json["low"] = vector_json(box.low - origin);
  json["step"] = vector_json(box.step);
  json["scale_low"] = low;
  json["scale_step"] = step;
  json["bytes"] = base64_text(deflated(bytes));
  return json;
}

}  // namespace gld
