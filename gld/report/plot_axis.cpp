#include "gld/report/plot_axis.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

namespace gld {

AxisLayout::AxisLayout(const PlotAxis& axis, const std::vector<double>& values, const std::string& where)
    : scale_(axis.scale) {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const double value : values) {
    if (!representable(value)) continue;
    low = std::min(low, value);
    high = std::max(high, value);
  }
  if (axis.low < axis.high && representable(axis.low)) {
    low = axis.low;
    high = axis.high;
  } else if (low > high) {
    fail({where, scale_ == AxisScale::kLog ? "a finite value above 0 to plot" : "a finite value to plot",
          "none", ""});
  } else if (scale_ == AxisScale::kLog) {
    const double margin = std::max(1.15, std::pow(high / low, 0.04));
    low /= margin;
    high *= margin;
  } else {
    // Between values that differ by rounding alone no tick could be told from the next.
    const bool apart = high - low > 1e-12 * std::max(std::abs(low), std::abs(high));
    const double margin = apart ? 0.05 * (high - low) : std::max(1e-300, 0.1 * std::abs(high) + 1e-12);
    low -= margin;
    high += margin;
  }
  low_ = low;
  high_ = high;
  if (scale_ == AxisScale::kLog) {
    make_log_ticks();
  } else {
    make_linear_ticks();
  }
}

bool AxisLayout::representable(double value) const {
  return std::isfinite(value) && (scale_ == AxisScale::kLinear || value > 0);
}

bool AxisLayout::shows(double value) const { return representable(value) && value >= low_ && value <= high_; }

double AxisLayout::position(double value) const {
  if (scale_ == AxisScale::kLinear) return (value - low_) / (high_ - low_);
  return std::log(value / low_) / std::log(high_ / low_);
}

void AxisLayout::make_log_ticks() {
  const int first = static_cast<int>(std::floor(std::log10(low_)));
  const int last = static_cast<int>(std::ceil(std::log10(high_)));
  const double decades = std::log10(high_ / low_);
  const int every = std::max(1, static_cast<int>(std::ceil(decades / 8)));
  for (int decade = first; decade <= last; ++decade) {
    for (int digit = 1; digit <= 9; ++digit) {
      const double value = digit * std::pow(10.0, decade);
      if (value < low_ || value > high_) continue;
      // Over few decades plain numbers read better than powers, and some digits need labels too.
      if (decades <= 2.5 && std::abs(decade) <= 3) {
        const bool labelled = digit == 1 || digit == 2 || digit == 5 || decades < 0.6;
        ticks_.push_back({value, labelled ? fmt::format("{:g}", value) : "", ""});
      } else if (digit == 1) {
        const bool labelled = (decade - first) % every == 0;
        ticks_.push_back({value, labelled ? "10" : "", labelled ? std::to_string(decade) : ""});
      } else if (every == 1) {
        ticks_.push_back({value, "", ""});
      }
    }
  }
}

void AxisLayout::make_linear_ticks() {
  const double rough = (high_ - low_) / 5, power = std::pow(10.0, std::floor(std::log10(rough)));
  const double digit = rough / power < 1.5 ? 1 : rough / power < 3.5 ? 2 : rough / power < 7.5 ? 5 : 10;
  const double step = digit * power;
  for (double k = std::ceil(low_ / step); k * step <= high_; ++k) {
    const double value = k == 0 ? 0 : k * step;  // not "-0"
    ticks_.push_back({value, fmt::format("{:.6g}", value), ""});
  }
}

}  // namespace gld
