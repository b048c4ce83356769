#pragma once

#include "gld/report/plot.h"

#include <string>
#include <vector>

namespace gld {

struct AxisTick {
  double value = 0;
  std::string label;     // empty for a minor tick
  std::string exponent;  // drawn raised behind the label
};

// The shown range of an axis and its ticks.
class AxisLayout {
 public:
  // values are every coordinate to be shown; those the scale cannot show (not finite, not positive on a log axis) do
  // not count. Throws Error when none is left; where names the panel.
  AxisLayout(const PlotAxis& axis, const std::vector<double>& values, const std::string& where);

  // Returns whether the value lies in the shown range.
  bool shows(double value) const;
  // Returns 0 at the low end and 1 at the high end.
  double position(double value) const;
  const std::vector<AxisTick>& ticks() const { return ticks_; }

 private:
  bool representable(double value) const;
  void make_log_ticks();
  void make_linear_ticks();

  AxisScale scale_;
  double low_ = 0;
  double high_ = 0;
  std::vector<AxisTick> ticks_;
};

}  // namespace gld
