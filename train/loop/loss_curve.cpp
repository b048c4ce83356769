#include "train/loop/loss_curve.h"

#include "gld/report/plot.h"
#include "gld/report/training_keys.h"

#include <algorithm>
#include <string>

namespace gld {
namespace {

// Long runs have more lines than a picture has columns: this takes means over groups of neighbours.
std::vector<std::pair<double, double>> thinned(const std::vector<std::pair<double, double>>& points) {
  constexpr size_t kMostPoints = 200;
  const size_t group = (points.size() + kMostPoints - 1) / kMostPoints;
  if (group <= 1) return points;
  std::vector<std::pair<double, double>> result;
  for (size_t first = 0; first < points.size(); first += group) {
    const size_t last = std::min(first + group, points.size());
    double step = 0.0, value = 0.0;
    for (size_t i = first; i < last; ++i) {
      step += points[i].first;
      value += points[i].second;
    }
    const auto count = static_cast<double>(last - first);
    result.emplace_back(step / count, value / count);
  }
  return result;
}

}  // namespace

void draw_loss_curve(const MetricsLog& metrics, const std::filesystem::path& file_without_ending) {
  PlotPanel losses, validation, rate;
  losses.title = "Losses";
  validation.title = "Validation";
  rate.title = "Learning rate and gradient norm";
  for (const std::string& key : metrics.keys()) {
    PlotSeries series;
    series.name = key;
    series.points = thinned(metrics.series(key));
    if (series.points.size() < 2) continue;
    const bool positive = std::all_of(series.points.begin(), series.points.end(),
                                      [](const auto& point) { return point.second > 0.0; });
    PlotPanel* panel = nullptr;
    if (key.rfind("validation_", 0) == 0) {
      series.name = key.substr(11);
      panel = &validation;
    } else if (key == "learning_rate" || key == "gradient_norm") {
      panel = &rate;
    } else if (!is_course_of_run(key)) {
      panel = &losses;
    }
    // A logarithmic axis cannot show losses with a reward, which may be negative.
    if (panel != nullptr && positive) panel->series.push_back(std::move(series));
  }
  Figure figure;
  figure.title = "Training";
  for (PlotPanel* panel : {&losses, &validation, &rate}) {
    if (panel->series.empty()) continue;
    panel->x.label = "step";
    panel->y.scale = AxisScale::kLog;
    figure.panels.push_back(*panel);
  }
  if (figure.panels.empty()) return;
  write_svg(figure, file_without_ending.string() + ".svg");
  write_png(figure, file_without_ending.string() + ".png");
}

}  // namespace gld
