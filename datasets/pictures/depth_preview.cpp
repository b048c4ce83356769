#include "datasets/pictures/depth_preview.h"

#include "datasets/pictures/colour_map.h"
#include "datasets/pictures/drawing.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr Rgb kBackground{24, 26, 30};
constexpr Rgb kUnknown{96, 96, 96};
constexpr Rgb kLegendInk{222, 224, 228};
constexpr int64_t kLegendHeight = 40;
constexpr int64_t kBarHeight = 12;
constexpr int64_t kLegendMargin = 12;
constexpr int64_t kNarrowest = 240;
constexpr double kSmallestRatio = 1.02;

// Returns 0 at the nearest depth, 1 at the farthest.
double log_position(double depth, const DepthRange& range) {
  return std::log(depth / range.nearest) / std::log(range.farthest / range.nearest);
}

Rgb depth_colour(double depth, const DepthRange& range) { return viridis(1 - log_position(depth, range)); }

float percentile(std::vector<float>& values, double fraction) {
  const auto nth = values.begin() + static_cast<std::ptrdiff_t>(
                                        std::lround(fraction * static_cast<double>(values.size() - 1)));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

// Returns round depths inside the range: multiples of a 1-2-5 step where the range is narrow, 1-2-5 decades where it is
// wide.
std::vector<double> tick_depths(const DepthRange& range) {
  std::vector<double> ticks;
  if (range.farthest > 6 * range.nearest) {
    for (double decade = std::pow(10, std::floor(std::log10(range.nearest))); decade <= range.farthest;
         decade *= 10) {
      for (const double factor : {1.0, 2.0, 5.0}) ticks.push_back(factor * decade);
    }
  } else {
    const double wanted = (range.farthest - range.nearest) / 4;
    double step = std::pow(10, std::floor(std::log10(wanted)));
    if (5 * step <= wanted) {
      step *= 5;
    } else if (2 * step <= wanted) {
      step *= 2;
    }
    const double first = std::ceil(range.nearest / step);
    for (int i = 0; i < 12; ++i) ticks.push_back((first + i) * step);
  }
  ticks.erase(std::remove_if(ticks.begin(), ticks.end(),
                             [&](double depth) {
                               return depth < range.nearest * (1 - 1e-9) ||
                                      depth > range.farthest * (1 + 1e-9);
                             }),
              ticks.end());
  return ticks;
}

}  // namespace

DepthRange robust_depth_range(const std::vector<DepthMap>& maps) {
  std::vector<float> known;
  for (const DepthMap& map : maps) {
    std::copy_if(map.metres.begin(), map.metres.end(), std::back_inserter(known), is_known_depth);
  }
  DepthRange range;
  if (known.empty()) return range;
  range.nearest = percentile(known, 0.01);
  range.farthest = percentile(known, 0.99);
  if (range.farthest < range.nearest * kSmallestRatio) {
    const double middle = std::sqrt(range.nearest * range.farthest);
    range.nearest = middle / std::sqrt(kSmallestRatio);
    range.farthest = middle * std::sqrt(kSmallestRatio);
  }
  return range;
}

Image coloured_depth(const DepthMap& depth, const DepthRange& range) {
  Image image(depth.width, depth.height);
  for (int64_t y = 0; y < depth.height; ++y) {
    for (int64_t x = 0; x < depth.width; ++x) {
      const float value = depth.at(x, y);
      const Rgb colour = is_known_depth(value) ? depth_colour(value, range) : kUnknown;
      std::copy(colour.begin(), colour.end(), image.pixel(x, y));
    }
  }
  return image;
}

Image depth_legend(const DepthRange& range, int64_t width, const std::string& unit, const Rgb& paper) {
  Image legend = filled_image(width, kLegendHeight, paper);
  const int64_t bar = std::max<int64_t>(width - 2 * kLegendMargin, 2);
  for (int64_t x = 0; x < bar; ++x) {
    const double position = static_cast<double>(x) / static_cast<double>(bar - 1);
    const double depth = range.nearest * std::pow(range.farthest / range.nearest, position);
    fill_rect(legend, {kLegendMargin + x, 4, 1, kBarHeight}, depth_colour(depth, range));
  }
  const TextStyle style{13, kLegendInk, TextWeight::kRegular};
  int64_t free_from = 2;
  for (const double depth : tick_depths(range)) {
    const std::string text = fmt::format("{:.4g}", depth) + (unit.empty() ? "" : " " + unit);
    const auto offset = std::lround(log_position(depth, range) * static_cast<double>(bar - 1));
    const int64_t x = kLegendMargin + static_cast<int64_t>(offset);
    const int64_t text_x = x - text_width(text, style) / 2;
    if (text_x < free_from || text_x + text_width(text, style) > width - 2) continue;
    fill_rect(legend, {x, 4 + kBarHeight, 1, 4}, kLegendInk);
    draw_text(legend, text_x, 22, text, style);
    free_from = text_x + text_width(text, style) + 12;
  }
  return legend;
}

Image depth_preview(const DepthMap& depth, const DepthRange& range, const std::string& unit) {
  const int64_t width = std::max(depth.width, kNarrowest);
  Image preview = filled_image(width, depth.height + kLegendHeight, kBackground);
  paste(preview, coloured_depth(depth, range), (width - depth.width) / 2, 0);
  paste(preview, depth_legend(range, width, unit, kBackground), 0, depth.height);
  return preview;
}

}  // namespace gld
