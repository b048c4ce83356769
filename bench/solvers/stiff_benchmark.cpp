#include "bench/solvers/stiff_benchmark.h"

#include "bench/support/benchmark_report.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/interrupt.h"
#include "gld/report/plot.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include <ATen/core/grad_mode.h>

#include <fmt/format.h>

namespace gld {
namespace {

std::string failure_text(const SolveFailure& failure) {
  switch (failure.kind) {
    case SolveFailureKind::kNonFinite:
      return fmt::format("non-finite {} at step {}, time {:.4g}", failure.what, failure.step, failure.time);
    case SolveFailureKind::kEvaluationLimit:
      return fmt::format("evaluation limit at time {:.4g}", failure.time);
    case SolveFailureKind::kStepTooSmall:
      break;
  }
  return fmt::format("step too small at time {:.4g}", failure.time);
}

std::string solver_label(const StiffRow& row) {
  return row.tolerance > 0 ? fmt::format("{} {:g}", row.solver, row.tolerance) : row.solver;
}

// Makes one line a problem and one column a solver: the evaluations of a finished solve with its error, or a dash.
std::string stiff_overview(const std::vector<StiffRow>& rows) {
  std::vector<std::string> labels, problems;
  for (const auto& row : rows) {
    if (std::find(labels.begin(), labels.end(), solver_label(row)) == labels.end())
      labels.push_back(solver_label(row));
    if (std::find(problems.begin(), problems.end(), row.problem) == problems.end())
      problems.push_back(row.problem);
  }
  auto columns = labels;
  columns.insert(columns.begin(), "problem");
  Table table(columns);
  for (const auto& problem : problems) {
    std::vector<TableCell> cells{problem};
    for (const auto& label : labels) {
      const auto row = std::find_if(rows.begin(), rows.end(), [&](const StiffRow& candidate) {
        return candidate.problem == problem && solver_label(candidate) == label;
      });
      const bool finished = row != rows.end() && row->finished;
      cells.emplace_back(finished ? fmt::format("{} ({})", row->evaluations, short_number(row->error)) : "-");
    }
    table.add_row(cells);
  }
  return table.markdown();
}

Figure stiff_figure(const std::vector<StiffRow>& rows) {
  Figure figure;
  figure.title = "Stiff problems: solves that finished";
  for (const std::string solver : {"rodas3", "dp54"}) {
    PlotPanel panel;
    panel.title = solver;
    panel.x = {"function evaluations", AxisScale::kLog, 8, 1e5};
    panel.y = {"RMS error / scale", AxisScale::kLog, 1e-12, 1};
    for (const auto& row : rows) {
      if (row.solver != solver || row.tolerance == 0) continue;
      auto series = std::find_if(panel.series.begin(), panel.series.end(),
                                 [&](const PlotSeries& entry) { return entry.name == row.problem; });
      if (series == panel.series.end()) {
        panel.series.push_back({row.problem, SeriesStyle::kLine, {}});
        series = panel.series.end() - 1;
      }
      if (row.finished) series->points.emplace_back(row.evaluations, row.error);
    }
    figure.panels.push_back(panel);
  }
  return figure;
}

}  // namespace

void StiffBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visitor.reals({"tolerances", "tolerances of the adaptive solvers"}, tolerances, {1e-14, 1});
  visitor.integer({"max_evaluations", "where an adaptive solver gives up"}, max_evaluations, {1, 1000000000});
  visitor.integer({"fixed_evaluations", "evaluations of the fixed-step solvers"}, fixed_evaluations,
                  {1, 10000000});
}

void StiffBenchmarkOptions::check() const { check_out(out, "runs/bench"); }

StiffRow solve_stiff_problem(const StiffProblem& problem, const SolverOptions& options) {
  constexpr double kAcceptedTolerances = 100, kFixedStepError = 0.01;
  const bool adaptive = is_adaptive(options.solver);
  StiffRow row;
  row.problem = problem.name;
  row.solver = solver_names()[static_cast<size_t>(options.solver)];
  row.tolerance = adaptive ? options.tolerance : 0;
  row.error = std::numeric_limits<double>::quiet_NaN();
  const auto start = std::chrono::steady_clock::now();
  const auto report =
      try_solve_on(*problem.field, problem.start, options, solver_times(options), {problem.name, {}});
  row.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  row.evaluations = report.evaluations;
  row.accepted = report.accepted;
  row.rejected = report.rejected;
  if (report.failure) {
    row.outcome = failure_text(*report.failure);
    return row;
  }
  const double error = stiff_error(problem, report.state);
  row.finished = error <= (adaptive ? kAcceptedTolerances * options.tolerance : kFixedStepError);
  row.outcome = row.finished ? "finished" : "inaccurate: error " + short_number(error);
  if (row.finished) row.error = error;
  return row;
}

std::vector<StiffRow> stiff_rows(const StiffBenchmarkOptions& benchmark) {
  std::vector<StiffRow> rows;
  const auto problems = stiff_problems();
  Progress progress("bench stiff", static_cast<int64_t>(problems.size()));
  SolverOptions options;
  options.max_evaluations = benchmark.max_evaluations;
  options.evaluations = benchmark.fixed_evaluations;
  options.schedule.schedule = ScheduleKind::kUniform;
  for (size_t i = 0; i < problems.size(); ++i) {
    for (const SolverKind solver : {SolverKind::kEuler, SolverKind::kHeun, SolverKind::kRungeKutta4,
                                    SolverKind::kAdamsBashforth3, SolverKind::kUniPc3}) {
      options.solver = solver;
      rows.push_back(solve_stiff_problem(problems[i], options));
    }
    for (const SolverKind solver :
         {SolverKind::kBogackiShampine, SolverKind::kDormandPrince, SolverKind::kRodas3}) {
      options.solver = solver;
      for (const double tolerance : benchmark.tolerances) {
        options.tolerance = tolerance;
        rows.push_back(solve_stiff_problem(problems[i], options));
        stop_if_interrupted(fmt::format("{} solves", rows.size()));
      }
    }
    progress.update(static_cast<int64_t>(i) + 1, problems[i].name);
  }
  progress.finish();
  return rows;
}

Table stiff_table(const std::vector<StiffRow>& rows) {
  Table table({"problem", "solver", "tolerance", "outcome", "evaluations", "accepted", "rejected", "seconds",
               "error_rms"});
  for (const auto& row : rows) {
    table.add_row({row.problem, row.solver,
                   row.tolerance > 0 ? TableCell(row.tolerance) : TableCell(std::string()), row.outcome,
                   row.evaluations, row.accepted, row.rejected, row.seconds,
                   row.finished ? TableCell(row.error) : TableCell(std::string())});
  }
  return table;
}

int run_stiff_benchmark(const StiffBenchmarkOptions& options) {
  const at::NoGradGuard no_grad;
  RunFolder folder(options.out, "bench stiff", options, earlier_run(options.overwrite));
  const auto start = std::chrono::steady_clock::now();
  const auto rows = stiff_rows(options);
  const std::string text =
      "# Stiff problems\n"
      "\n"
      "Function evaluations (RMS error) of the solves that finished, by solver and tolerance; "
      "a dash is a failure, whose reason is in the second table.\n"
      "\n" +
      stiff_overview(rows) + "\n## Every solve\n\n" + stiff_table(rows).markdown();
  const auto finished =
      std::count_if(rows.begin(), rows.end(), [](const StiffRow& row) { return row.finished; });
  BenchmarkResults results;
  results.text = stiff_overview(rows);
  results.files = {{"stiff.csv", stiff_table(rows).csv()}, {"stiff.md", text}};
  results.figures = {{"stiff", stiff_figure(rows)}};
  results.report = {
      {"command", "bench stiff"},
      {"options", to_json(options)},
      {"solves", rows.size()},
      {"finished", finished},
      {"seconds", std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count()}};
  results.notes = {{"every solve", "stiff.csv"}, {"tables", "stiff.md"}, {"error against work", "stiff.png"}};
  return finish_measured_benchmark(folder, results);
}

}  // namespace gld
