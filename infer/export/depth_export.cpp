#include "infer/export/depth_export.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <string>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kSteps = 65535;
constexpr double kOutlierFactor = 4;
constexpr double kUnknownUnit = 1e-3;

// Returns the smallest of 1, 2, 5 times a power of ten that is at least value. It is read from text, because factor *
// 10^n is rounded and would print as 2.0000000000000002e-05.
double rounded_up(double value) {
  const auto exponent = static_cast<int>(std::floor(std::log10(value)));
  for (const char* digits : {"1e{}", "2e{}", "5e{}"}) {
    const double candidate = std::stod(fmt::format(fmt::runtime(digits), exponent));
    if (candidate >= value * (1 - 1e-6)) return candidate;
  }
  return std::stod(fmt::format("1e{}", exponent + 1));
}

}  // namespace

double choose_depth_unit(const std::vector<DepthMap>& maps) {
  std::vector<float> known;
  for (const DepthMap& map : maps) {
    std::copy_if(map.metres.begin(), map.metres.end(), std::back_inserter(known), is_known_depth);
  }
  if (known.empty()) return kUnknownUnit;
  const auto nth =
      known.begin() + static_cast<std::ptrdiff_t>(std::ceil(0.995 * static_cast<double>(known.size() - 1)));
  std::nth_element(known.begin(), nth, known.end());
  const double usual = kOutlierFactor * static_cast<double>(*nth);
  double largest = 0;
  for (const float depth : known) {
    if (depth <= usual) largest = std::max(largest, static_cast<double>(depth));
  }
  return rounded_up(largest / kSteps);
}

Grey16 quantised_depth(const DepthMap& depth, double unit) {
  if (!(unit > 0) || !std::isfinite(unit)) {
    fail({"depth unit", "a positive length", fmt::format("{}", unit), "check the depth maps"});
  }
  Grey16 image;
  image.width = depth.width;
  image.height = depth.height;
  image.values.reserve(depth.metres.size());
  for (const float value : depth.metres) {
    const double steps = is_known_depth(value) ? std::clamp(std::round(value / unit), 1.0, kSteps) : 0.0;
    image.values.push_back(static_cast<uint16_t>(steps));
  }
  return image;
}

void export_depth_png(const std::filesystem::path& file, const DepthMap& depth, double unit,
                      const Provenance& provenance) {
  TextItems texts = provenance_items(provenance);
  texts.emplace_back("gld:depth_unit", fmt::format("{}", unit));
  write_file_atomically(file, encode_png(quantised_depth(depth, unit), texts));
}

}  // namespace gld
