#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace gld {

enum class AxisScale { kLinear, kLog };

struct PlotAxis {
  std::string label;
  AxisScale scale = AxisScale::kLinear;
  // Shown range; where low >= high it is taken from the data.
  double low = 0;
  double high = 0;
};

enum class SeriesStyle {
  kLine,     // markers joined by a line
  kMarkers,  // markers alone
  kFront,    // a dashed grey staircase with rings: the Pareto front
  kLevel,    // a dotted line without markers, for targets and references
};

struct PlotSeries {
  std::string name;  // in the legend; empty for none
  SeriesStyle style = SeriesStyle::kLine;
  std::vector<std::pair<double, double>> points;  // those that an axis cannot show are left out
};

struct PlotPanel {
  std::string title;
  PlotAxis x;
  PlotAxis y;
  std::vector<PlotSeries> series;
};

// Panels side by side under one title, with one legend: series of equal names share colour and marker.
struct Figure {
  std::string title;
  std::vector<PlotPanel> panels;
  int64_t panel_width = 520;  // pixels
  int64_t height = 440;
};

// Draws the figure with cairo, the same commands for both kinds of file; the file is written to a temporary name and
// renamed. Throws Error for a figure without panels or with nothing to show in a panel.
void write_svg(const Figure& figure, const std::filesystem::path& file);
void write_png(const Figure& figure, const std::filesystem::path& file);

// Returns the points no other point beats in both coordinates (smaller is better), by increasing x.
std::vector<std::pair<double, double>> pareto_front(std::vector<std::pair<double, double>> points);

}  // namespace gld
