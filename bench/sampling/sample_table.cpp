#include "bench/sampling/sample_table.h"

#include "gld/metrics/metric_list.h"
#include "infer/method/plan_errors.h"

#include <cmath>
#include <functional>
#include <limits>
#include <set>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
constexpr double Sample::*kAveraged[] = {&Sample::precision_error, &Sample::psnr_to_reference, &Sample::flop,
                                         &Sample::seconds};

Sample mean_of(const std::vector<Sample>& samples) {
  Sample mean = samples.front();
  const auto count = static_cast<double>(samples.size());
  mean.scene = "mean";
  for (const auto value : kAveraged) mean.*value = 0;
  mean.quality.clear();
  for (auto& [level, error] : mean.level_errors) error = 0;
  mean.evaluations = mean.unconditional = mean.non_finite = 0;
  for (const Sample& sample : samples) {
    for (const auto value : kAveraged) mean.*value += sample.*value / count;
    for (auto& [level, error] : mean.level_errors) error += sample.level_errors.at(level) / count;
    mean.evaluations += sample.evaluations;
    mean.unconditional += sample.unconditional;
    mean.non_finite += sample.non_finite;
    mean.peak_bytes = std::max(mean.peak_bytes, sample.peak_bytes);
  }
  mean.evaluations /= static_cast<int64_t>(samples.size());
  mean.unconditional /= static_cast<int64_t>(samples.size());
  for (const Metric& metric : image_metric_list()) {
    double sum = 0;
    for (const Sample& sample : samples) sum += sample.quality_of(metric.name) / count;
    if (!std::isnan(sum)) mean.quality[metric.name] = sum;
  }
  return mean;
}

TableCell measured(double value) { return std::isnan(value) ? TableCell(std::string()) : TableCell(value); }

std::string guidance_text(const ComparedMethod& compared) {
  if (compared.guidance_scale == 1) return "none";
  const double low = compared.method.guidance_interval[0];
  return low > 0 ? fmt::format("from t = {:g}", low) : "everywhere";
}

// Returns solver, schedule, count, guidance and precision, as both tables name them.
std::vector<std::string> method_columns() {
  return {"method", "family", "solver", "schedule", "count", "guidance_scale", "guidance", "precision"};
}

std::vector<TableCell> method_cells(const ComparedMethod& compared) {
  const SolverOptions& solver = compared.method.solver;
  return {compared.method.name,
          compared.family,
          solver_names()[static_cast<size_t>(solver.solver)],
          schedule_names()[static_cast<size_t>(solver.schedule.schedule)],
          solver.evaluations,
          compared.guidance_scale,
          guidance_text(compared),
          compute_precision_name(compared.method.precision)};
}

std::vector<TableCell> reference_cells(double guidance_scale) {
  const std::string guidance = guidance_scale == 1 ? "none" : "everywhere";
  return {std::string("reference"),
          std::string("reference"),
          std::string("reference"),
          std::string(),
          int64_t{0},
          guidance_scale,
          guidance,
          std::string("float32")};
}

// Returns the levels that any sample has, the boundary level first: it is generated first.
std::vector<int64_t> levels_of(const std::vector<MethodRow>& rows) {
  std::set<int64_t, std::greater<>> levels;
  for (const MethodRow& row : rows) {
    for (const Sample& sample : row.samples) {
      for (const auto& [level, error] : sample.level_errors) levels.insert(level);
    }
  }
  return {levels.begin(), levels.end()};
}

void add_level_columns(std::vector<std::string>& columns, const std::vector<int64_t>& levels) {
  for (const int64_t level : levels) columns.push_back(fmt::format("level{}_error", level));
}

void add_level_cells(std::vector<TableCell>& cells, const std::vector<int64_t>& levels,
                     const Sample& sample) {
  for (const int64_t level : levels) {
    const auto found = sample.level_errors.find(level);
    cells.push_back(measured(found == sample.level_errors.end() ? kNotMeasured : found->second));
  }
}

void add_metric_columns(std::vector<std::string>& columns) {
  for (const Metric& metric : image_metric_list()) columns.push_back(metric.name);
}

void add_metric_cells(std::vector<TableCell>& cells, const Sample& sample) {
  for (const Metric& metric : image_metric_list()) cells.push_back(measured(sample.quality_of(metric.name)));
}

// Marks the rows of one guidance scale that no other beats in both seconds and `value`, smaller being better.
template <class Value>
void mark_front(std::vector<MethodRow>& rows, double guidance_scale, bool MethodRow::*on_front,
                const Value& value) {
  const auto takes_part = [&](const MethodRow& row) {
    return row.compared.guidance_scale == guidance_scale && row.finite() && std::isfinite(value(row));
  };
  std::vector<std::pair<double, double>> points;
  for (const auto& row : rows) {
    if (takes_part(row)) points.emplace_back(row.seconds, value(row));
  }
  const auto front = pareto_front(points);
  for (auto& row : rows) {
    if (!takes_part(row)) continue;
    row.*on_front = std::find(front.begin(), front.end(), std::pair(row.seconds, value(row))) != front.end();
  }
}

// Draws one line for a family with several counts, points for the others, and the front.
template <class X, class Y>
PlotPanel panel_of(const std::vector<MethodRow>& rows, double guidance_scale, PlotPanel panel, const X& x,
                   const Y& y) {
  for (const auto& row : rows) {
    if (row.compared.guidance_scale != guidance_scale || !row.finite()) continue;
    auto series = std::find_if(panel.series.begin(), panel.series.end(),
                               [&](const PlotSeries& entry) { return entry.name == row.compared.family; });
    if (series == panel.series.end()) {
      const bool line = row.compared.is_fewer_evaluations() || !row.compared.is_offered();
      panel.series.push_back({row.compared.family, line ? SeriesStyle::kLine : SeriesStyle::kMarkers, {}});
      series = panel.series.end() - 1;
    }
    series->points.emplace_back(x(row), y(row));
  }
  return panel;
}

}  // namespace

double worst_error(const std::map<int64_t, double>& level_errors) {
  double worst = 0;
  for (const auto& [level, error] : level_errors) {
    if (std::isnan(error)) return kNotMeasured;
    worst = std::max(worst, error);
  }
  return worst;
}

double Sample::error() const { return worst_error(level_errors); }

double Sample::quality_of(const std::string& metric) const {
  const auto found = quality.find(metric);
  return found == quality.end() ? kNotMeasured : found->second;
}

double error_at_cost(std::vector<std::pair<double, double>> points, double cost) {
  for (auto& [work, error] : points) error = std::max(error, 1e-300);
  std::sort(points.begin(), points.end());
  size_t end = 1;
  while (end + 1 < points.size() && points[end].first < cost) ++end;
  const auto &low = points[end - 1], &high = points[end];
  const double share = std::log(cost / low.first) / std::log(high.first / low.first);
  return std::exp((1 - share) * std::log(low.second) + share * std::log(high.second));
}

void summarise(std::vector<MethodRow>& rows, const std::map<double, std::vector<Sample>>& references) {
  std::map<double, std::vector<std::pair<double, double>>> by_flop, by_seconds;
  for (auto& row : rows) {
    const double scale = row.compared.guidance_scale;
    row.mean = mean_of(row.samples);
    row.mean_error = row.largest_error = 0;
    for (const Sample& sample : row.samples) {
      row.mean_error += sample.error() / static_cast<double>(row.samples.size());
      row.largest_error = std::max(row.largest_error, sample.error());
    }
    const auto reference = references.find(scale);
    row.psnr_difference = reference == references.end()
                              ? kNotMeasured
                              : row.mean.quality_of("psnr") - mean_of(reference->second).quality_of("psnr");
    if (!row.compared.is_fewer_evaluations() || !row.finite()) continue;
    by_flop[scale].emplace_back(row.mean.flop, row.mean_error);
    by_seconds[scale].emplace_back(row.seconds, row.mean_error);
  }
  std::set<double> scales;
  for (auto& row : rows) {
    const double scale = row.compared.guidance_scale;
    scales.insert(scale);
    const bool compared = !row.compared.is_fewer_evaluations() && row.finite() && by_flop[scale].size() > 1;
    const bool in_float32 = row.compared.method.precision == ComputePrecision::kFloat32;
    row.error_at_equal_flop = compared && in_float32 ? error_at_cost(by_flop[scale], row.mean.flop) : 0;
    row.error_at_equal_seconds = compared ? error_at_cost(by_seconds[scale], row.seconds) : 0;
  }
  for (const double scale : scales) {
    mark_front(rows, scale, &MethodRow::on_error_front, [](const MethodRow& row) { return row.mean_error; });
    mark_front(rows, scale, &MethodRow::on_quality_front,
               [](const MethodRow& row) { return -row.mean.quality_of("psnr"); });
  }
}

Table sample_table(const std::vector<MethodRow>& rows,
                   const std::map<double, std::vector<Sample>>& references) {
  std::vector<std::string> columns{"scene"};
  for (auto& column : method_columns()) columns.push_back(std::move(column));
  columns.emplace_back("evaluations");
  columns.emplace_back("unconditional");
  const std::vector<int64_t> levels = levels_of(rows);
  add_level_columns(columns, levels);
  columns.emplace_back("precision_error");
  add_metric_columns(columns);
  for (const char* name : {"psnr_to_reference", "gflop", "seconds", "peak_bytes", "non_finite"})
    columns.emplace_back(name);
  Table table(columns);
  const auto add = [&](const Sample& sample, const std::vector<TableCell>& names) {
    if (sample.scene.empty()) return;  // not there yet
    std::vector<TableCell> cells{sample.scene};
    cells.insert(cells.end(), names.begin(), names.end());
    cells.insert(cells.end(), {TableCell(sample.evaluations), TableCell(sample.unconditional)});
    add_level_cells(cells, levels, sample);
    cells.emplace_back(sample.precision_error);
    add_metric_cells(cells, sample);
    cells.insert(cells.end(),
                 {measured(sample.psnr_to_reference), TableCell(sample.flop / 1e9), TableCell(sample.seconds),
                  TableCell(sample.peak_bytes), TableCell(sample.non_finite)});
    table.add_row(cells);
  };
  for (const auto& [scale, samples] : references) {
    for (const Sample& sample : samples) add(sample, reference_cells(scale));
  }
  for (const auto& row : rows) {
    for (const Sample& sample : row.samples) add(sample, method_cells(row.compared));
  }
  return table;
}

Table method_table(const std::vector<MethodRow>& rows) {
  auto columns = method_columns();
  for (const char* name : {"gflop", "seconds", "peak_megabytes", "mean_error", "largest_error"})
    columns.emplace_back(name);
  const std::vector<int64_t> levels = levels_of(rows);
  add_level_columns(columns, levels);
  add_metric_columns(columns);
  for (const char* name :
       {"psnr_difference", "psnr_to_reference", "non_finite", "error_at_equal_gflop", "wins_at_equal_gflop",
        "error_at_equal_seconds", "wins_at_equal_seconds", "pareto"})
    columns.emplace_back(name);
  Table table(columns);
  const auto wins = [](const MethodRow& row, double other) {
    return TableCell(other == 0 ? std::string() : row.mean_error < other ? "this" : "fewer evaluations");
  };
  const auto compared = [](double other) { return other == 0 ? TableCell(std::string()) : TableCell(other); };
  for (const auto& row : rows) {
    auto cells = method_cells(row.compared);
    cells.insert(cells.end(), {TableCell(row.mean.flop / 1e9), TableCell(row.seconds),
                               TableCell(static_cast<double>(row.peak_bytes) / 1e6), measured(row.mean_error),
                               measured(row.largest_error)});
    add_level_cells(cells, levels, row.mean);
    add_metric_cells(cells, row.mean);
    const std::string front = row.on_error_front && row.on_quality_front ? "error and psnr"
                              : row.on_error_front                       ? "error"
                              : row.on_quality_front                     ? "psnr"
                                                                         : "";
    cells.insert(cells.end(), {measured(row.psnr_difference), measured(row.mean.psnr_to_reference),
                               TableCell(row.mean.non_finite), compared(row.error_at_equal_flop),
                               wins(row, row.error_at_equal_flop), compared(row.error_at_equal_seconds),
                               wins(row, row.error_at_equal_seconds), TableCell(front)});
    table.add_row(cells);
  }
  return table;
}

std::string precisions_text(const std::vector<MethodRow>& rows) {
  Table table({"method", "guidance_scale", "precision_error_mean", "precision_error_largest", "limit"});
  for (const auto& row : rows) {
    const ComputePrecision precision = row.compared.method.precision;
    if (precision == ComputePrecision::kFloat32) continue;
    double largest = 0;
    for (const Sample& sample : row.samples) largest = std::max(largest, sample.precision_error);
    table.add_row({row.compared.method.name, row.compared.guidance_scale, row.mean.precision_error, largest,
                   largest_automatic_error(precision)});
  }
  return table.rows().empty()
             ? ""
             : "\nAgainst the same method in float32, relative RMS of the latents, and above what --precision "
               "automatic leaves a precision out:\n\n" +
                   table.markdown();
}

Figure sample_figure(const std::vector<MethodRow>& rows, double guidance_scale) {
  const auto error = [](const MethodRow& row) { return row.mean_error; };
  const auto seconds = [](const MethodRow& row) { return row.seconds; };
  const auto psnr = [](const MethodRow& row) { return row.mean.quality_of("psnr"); };
  const PlotAxis error_axis{"mean relative latent error", AxisScale::kLog};
  const PlotAxis seconds_axis{"seconds of both flows", AxisScale::kLog};
  const PlotAxis work_axis{"GFLOP of both flows", AxisScale::kLog};
  const PlotAxis quality_axis{"PSNR to truth (dB)", AxisScale::kLinear};
  const auto panel = [](const char* title, const PlotAxis& x, const PlotAxis& y) {
    PlotPanel empty;
    empty.title = title;
    empty.x = x;
    empty.y = y;
    return empty;
  };
  Figure figure;
  figure.title = fmt::format("Ways to sample: error against work and time, guidance {:g}", guidance_scale);
  figure.panels.push_back(panel_of(
      rows, guidance_scale, panel("error against work", work_axis, error_axis),
      [](const MethodRow& row) { return row.mean.flop / 1e9; }, error));
  figure.panels.push_back(
      panel_of(rows, guidance_scale, panel("error against time", seconds_axis, error_axis), seconds, error));
  if (std::any_of(rows.begin(), rows.end(), [&](const MethodRow& row) { return std::isfinite(psnr(row)); })) {
    figure.panels.push_back(panel_of(
        rows, guidance_scale, panel("quality against time", seconds_axis, quality_axis), seconds, psnr));
  }
  PlotSeries front{"Pareto front", SeriesStyle::kFront, {}};
  for (const auto& row : rows) {
    if (row.compared.guidance_scale == guidance_scale && row.on_error_front)
      front.points.emplace_back(row.seconds, row.mean_error);
  }
  std::sort(front.points.begin(), front.points.end());
  figure.panels[1].series.push_back(std::move(front));
  return figure;
}

BoundCheck check_bounds(const std::vector<MethodRow>& rows) {
  BoundCheck check;
  for (const auto& row : rows) {
    if (!row.finite()) continue;
    for (const size_t half : {0U, 1U}) {
      std::vector<double> known;
      for (size_t i = half; i < row.samples.size(); i += 2) known.push_back(row.samples[i].error());
      if (known.empty()) continue;
      const double bound = error_bound(known);
      for (size_t i = 1 - half; i < row.samples.size(); i += 2) {
        ++check.samples;
        check.exceeded += row.samples[i].error() > bound ? 1 : 0;
      }
    }
  }
  return check;
}

}  // namespace gld
