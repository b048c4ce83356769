#include "bench/solvers/solver_benchmark_figures.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <map>
#include <string>

namespace gld {
namespace {

using Points = std::vector<std::pair<double, double>>;
using Coordinate = std::function<double(const SolverRow&)>;

double evaluations_of(const SolverRow& row) { return static_cast<double>(row.evaluations); }
double solve_seconds(const SolverRow& row) { return row.seconds; }

// The points are in the order of the rows: by evaluations, or by tolerance.
Points points_of(const std::vector<SolverRow>& rows, const Coordinate& x,
                 const std::function<bool(const SolverRow&)>& chosen) {
  Points points;
  for (const auto& row : rows) {
    if (chosen(row) && std::isfinite(row.error_rms)) points.emplace_back(x(row), row.error_rms);
  }
  return points;
}

std::vector<SolverRow> mixture_rows(const std::vector<SolverRow>& rows) {
  std::vector<SolverRow> chosen;
  std::copy_if(rows.begin(), rows.end(), std::back_inserter(chosen),
               [](const SolverRow& row) { return row.problem == "mixture"; });
  return chosen;
}

PlotPanel work_precision_panel(const std::vector<SolverRow>& rows, const std::string& label,
                               const Coordinate& x) {
  PlotPanel panel;
  panel.title = "Error against " + label;
  panel.x = {label, AxisScale::kLog, 0, 0};
  panel.y = {"RMS error / standard deviation", AxisScale::kLog, 1e-5, 2};
  for (const char* solver :
       {"euler", "heun", "midpoint", "rk4", "ab2", "ab3", "dpmpp2m", "dpmpp3m", "unipc2", "unipc3"}) {
    panel.series.push_back({solver, SeriesStyle::kLine, points_of(rows, x, [&](const SolverRow& row) {
                              return row.solver == solver && row.schedule == "logsnr";
                            })});
  }
  for (const char* solver : {"bs32", "dp54"}) {
    panel.series.push_back({std::string(solver) + ", adaptive", SeriesStyle::kLine,
                            points_of(rows, x, [&](const SolverRow& row) { return row.solver == solver; })});
  }
  panel.series.push_back(
      {"euler, published grid", SeriesStyle::kLine, points_of(rows, x, [](const SolverRow& row) {
         return row.solver == "euler" && row.schedule == "published";
       })});
  panel.series.push_back({"Pareto front", SeriesStyle::kFront,
                          pareto_front(points_of(rows, x, [](const SolverRow&) { return true; }))});
  return panel;
}

}  // namespace

const std::vector<std::pair<double, double>>& mixture_targets() {
  static const Points targets{{6, 0.30}, {12, 0.075}, {16, 0.032}, {20, 0.010}};
  return targets;
}

Figure work_precision_figure(const std::vector<SolverRow>& all_rows) {
  const auto rows = mixture_rows(all_rows);
  Figure figure;
  figure.title = "Gaussian mixture: solvers on the log-SNR grid";
  figure.height = 480;
  figure.panels = {work_precision_panel(rows, "function evaluations", evaluations_of),
                   work_precision_panel(rows, "seconds", solve_seconds)};
  auto& by_evaluations = figure.panels[0];
  by_evaluations.x.low = 3.5;
  by_evaluations.x.high = 1000;
  by_evaluations.series.push_back({"targets", SeriesStyle::kLevel, mixture_targets()});
  return figure;
}

Figure schedule_figure(const std::vector<SolverRow>& all_rows) {
  const auto rows = mixture_rows(all_rows);
  Figure figure;
  figure.title = "Gaussian mixture: schedules";
  for (const char* solver : {"euler", "unipc3"}) {
    PlotPanel panel;
    panel.title = solver;
    panel.x = {"function evaluations", AxisScale::kLog, 0, 0};
    panel.y = {"RMS error / standard deviation", AxisScale::kLog, 3e-4, 1.5};
    for (const char* schedule : {"published", "uniform", "shifted", "karras", "logsnr"}) {
      panel.series.push_back(
          {schedule, SeriesStyle::kLine, points_of(rows, evaluations_of, [&](const SolverRow& row) {
             return row.solver == solver && row.schedule == schedule;
           })});
    }
    panel.series.push_back({"targets", SeriesStyle::kLevel, mixture_targets()});
    figure.panels.push_back(panel);
  }
  return figure;
}

Figure width_figure(const std::vector<SolverRow>& rows) {
  static const std::string kPrefix = "gaussian_";
  constexpr int64_t kWanted = 16;
  // The count that was measured nearest to it: --counts may leave it out.
  int64_t budget = 0;
  for (const auto& row : rows) {
    if (row.budget == 0 || row.problem.rfind(kPrefix, 0) != 0) continue;
    if (budget == 0 || std::abs(row.budget - kWanted) < std::abs(budget - kWanted)) budget = row.budget;
  }
  Figure figure;
  figure.title = "Single Gaussians, " + std::to_string(budget) + " evaluations";
  for (const char* schedule : {"logsnr", "published"}) {
    PlotPanel panel;
    panel.title = std::string("schedule ") + schedule;
    panel.x = {"width of the data", AxisScale::kLog, 0, 0};
    panel.y = {"RMS error / width", AxisScale::kLog, 0, 0};
    for (const char* solver : {"euler", "heun", "ab2", "dpmpp2m", "dpmpp3m", "unipc2", "unipc3"}) {
      Points points;
      for (const auto& row : rows) {
        if (row.problem.rfind(kPrefix, 0) != 0 || row.solver != solver || row.schedule != schedule) continue;
        if (row.budget == budget && std::isfinite(row.error_rms)) {
          points.emplace_back(std::strtod(row.problem.c_str() + kPrefix.size(), nullptr), row.error_rms);
        }
      }
      std::sort(points.begin(), points.end());
      panel.series.push_back({solver, SeriesStyle::kLine, points});
    }
    figure.panels.push_back(panel);
  }
  return figure;
}

}  // namespace gld
