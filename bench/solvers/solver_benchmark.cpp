#include "bench/solvers/solver_benchmark.h"

#include "bench/solvers/solver_benchmark_figures.h"
#include "bench/support/benchmark_report.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/sha256.h"
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

constexpr int64_t kPublishedEvaluations = 49;

const std::vector<ScheduleKind>& swept_schedules() {
  static const std::vector<ScheduleKind> schedules{ScheduleKind::kPublished, ScheduleKind::kUniform,
                                                   ScheduleKind::kShifted, ScheduleKind::kKarras,
                                                   ScheduleKind::kLogSnr};
  return schedules;
}

GuidanceOptions guidance_of(const FlowProblem& problem) {
  GuidanceOptions guidance;
  guidance.guidance_scale = problem.guidance_scale;
  return guidance;
}

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Returns mixtures on which the grid's rule was not fitted.
std::vector<FlowProblem> unseen_problems() {
  std::vector<FlowProblem> problems;
  RandomMixtureOptions options;
  options.solution_tolerance = 1e-7;
  for (const uint64_t seed : {11, 12, 13}) {
    options.seed = seed;
    options.dimensions = seed == 11 ? 24 : seed == 12 ? 48 : 64;
    options.guidance_scale = seed == 13 ? 3 : 1.5;
    problems.push_back(random_mixture_problem(options));
  }
  return problems;
}

std::vector<SolverRow> default_rows(const FlowProblem& problem) {
  std::vector<SolverRow> rows;
  SolverOptions options;
  for (const auto& [evaluations, error] : mixture_targets()) {
    options.evaluations = static_cast<int64_t>(evaluations);
    rows.push_back(solve_problem(problem, options));
  }
  return rows;
}

// The table says what a guidance interval saves and changes.
Table guidance_table(const FlowProblem& problem) {
  Table table({"guidance", "evaluations", "unconditional", "saved_percent", "error_rms"});
  const auto add = [&](const std::string& name, const GuidanceOptions& guidance) {
    MixtureBranches branches(problem.mixture, problem.conditional_components);
    GuidedField field(branches, guidance);
    SolverOptions options;
    options.evaluations = 20;
    const auto report = solve(field, problem.noise, options, {"guidance comparison", {}});
    const auto& counts = field.report();
    const double saved = 50.0 * static_cast<double>(counts.evaluations - counts.unconditional) /
                         static_cast<double>(counts.evaluations);
    table.add_row(
        {name, counts.evaluations, counts.unconditional, saved, flow_error(problem, report.state).rms});
  };
  auto guidance = guidance_of(problem);
  add("everywhere", guidance);
  for (const double low : {0.5, 0.9}) {
    guidance.guidance_interval = {low, 1};
    add(fmt::format("t from {}", low), guidance);
  }
  return table;
}

// Stochastic paths differ from the flow's by design, so what counts is their distribution: the relative error of the
// standard deviation, and the error of the mean in units of it.
Table stochastic_table() {
  Table table({"width", "solver", "diffusion", "evaluations", "spread_error", "mean_error"});
  for (const double width : {10.0, 1.0, 0.1}) {
    SingleGaussianOptions gaussian;
    gaussian.width = width;
    gaussian.samples = 4096;
    const auto problem = single_gaussian_problem(gaussian);
    for (const SolverKind solver : {SolverKind::kEulerMaruyama, SolverKind::kStochasticHeun}) {
      for (const auto& [form, name] :
           {std::pair{DiffusionForm::kLinear, "linear"}, {DiffusionForm::kQuadratic, "quadratic"}}) {
        for (const int64_t evaluations : {20, 50, 200}) {
          SolverOptions options;
          options.solver = solver;
          options.diffusion = form;
          options.evaluations = evaluations;
          MixtureField field(problem.mixture);
          const auto report = solve(field, problem.noise, options);
          table.add_row({width, solver_names()[static_cast<size_t>(solver)], std::string(name),
                         report.evaluations, report.state.std().item<double>() / width - 1,
                         (report.state.mean().item<double>() - 0.5) / width});
        }
      }
    }
  }
  return table;
}

std::string headline(const std::vector<SolverRow>& rows) {
  Table table({"solver", "schedule", "4", "6", "8", "12", "16", "20", "32", "49"});
  const auto error_at = [&](const std::string& solver, const std::string& schedule,
                            int64_t budget) -> TableCell {
    for (const auto& row : rows) {
      if (row.problem == "mixture" && row.solver == solver && row.schedule == schedule &&
          row.budget == budget) {
        return std::isfinite(row.error_rms) ? TableCell(row.error_rms) : TableCell(std::string("stopped"));
      }
    }
    return std::string();
  };
  const auto add = [&](const std::string& solver, const std::string& schedule) {
    std::vector<TableCell> cells{solver, schedule};
    for (const int64_t count : {4, 6, 8, 12, 16, 20, 32, 49})
      cells.push_back(error_at(solver, schedule, count));
    table.add_row(cells);
  };
  add("euler", "published");
  for (const char* solver :
       {"euler", "heun", "rk4", "ab2", "ab3", "dpmpp2m", "dpmpp3m", "unipc2", "unipc3"}) {
    add(solver, "logsnr");
  }
  return table.markdown();
}

nlohmann::ordered_json target_report(const std::vector<SolverRow>& rows) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (size_t i = 0; i < rows.size(); ++i) {
    const double target = mixture_targets()[i].second;
    list.push_back({{"evaluations", rows[i].evaluations},
                    {"error_rms", rows[i].error_rms},
                    {"target", target},
                    {"met", rows[i].error_rms <= target}});
  }
  return list;
}

// tests/data/problems/mixture.safetensors, which the targets are of.
constexpr const char* kTargetedProblem = "a3ec2d3784c959d806cf121d3b4d97fb13296db7e815df8eae628b9647739295";

// The text is that of another mixture, for which no targets were set.
std::string untargeted_text(const std::vector<SolverRow>& rows) {
  Table table({"evaluations", "error_rms"});
  for (const SolverRow& row : rows) table.add_row({row.evaluations, row.error_rms});
  return table.markdown() +
         "\nThis is another mixture than that of docs/RESULTS.md, which has targets: "
         "--problem tests/data/problems/mixture.safetensors.\n";
}

std::string targeted_text(const std::vector<SolverRow>& targets) {
  Table met({"evaluations", "error_rms", "target", "met"});
  for (size_t i = 0; i < targets.size(); ++i) {
    const double target = mixture_targets()[i].second;
    met.add_row({targets[i].evaluations, targets[i].error_rms, target,
                 std::string(targets[i].error_rms <= target ? "yes" : "no")});
  }
  return met.markdown();
}

std::string report_text(const std::vector<SolverRow>& rows, const std::string& by_default,
                        const Table& unseen, const Table& guidance, const Table& stochastic) {
  return "# Solvers and schedules\n"
         "\n"
         "Errors are the RMS over samples and dimensions of (x - solution) / standard deviation.\n"
         "\n"
         "## The default\n"
         "\n"
         "unipc3 on the logsnr schedule; the grid's end points follow from the number of evaluations n "
         "alone: first_time = 1 - 0.04/n - 10.8/n^4, final_time = min(0.022, 2.6/n^2).\n"
         "\n" +
         by_default + "\n## The mixture, by evaluations\n\n" + headline(rows) +
         "\n## Mixtures the rule was not fitted to (default solver and schedule)\n\n" + unseen.markdown() +
         "\n## Guidance (20 evaluations, default solver)\n\n" + guidance.markdown() +
         "\n## Stochastic solvers: the distribution they reach\n\n" + stochastic.markdown();
}

}  // namespace

void SolverBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visitor.text({"problem", "problem file (safetensors); empty: the built-in mixture"}, problem);
  visitor.integers({"counts", "function evaluations to try"}, counts, {1, 100000});
  visitor.reals({"tolerances", "tolerances of the adaptive solvers to try"}, tolerances, {1e-14, 1});
  visitor.real({"shift", "time shift of the schedules published and shifted"}, shift, {1, 1e6});
}

void SolverBenchmarkOptions::check() const {
  if (counts.empty())
    fail({"counts", "at least one number of evaluations", "none", "write for example [6, 12]"});
  check_out(out, "runs/bench");
}

FlowProblem benchmark_problem(const SolverBenchmarkOptions& options) {
  if (!options.problem.empty()) return read_flow_problem(options.problem, "mixture");
  RandomMixtureOptions random;
  random.dimensions = 48;
  random.components = 8;
  random.conditional_components = 3;
  random.samples = 192;
  auto problem = random_mixture_problem(random);
  problem.name = "mixture";
  return problem;
}

SolverRow solve_problem(const FlowProblem& problem, const SolverOptions& options) {
  constexpr int kTimings = 3;
  SolverRow row;
  row.problem = problem.name;
  row.solver = solver_names()[static_cast<size_t>(options.solver)];
  row.schedule = is_adaptive(options.solver)
                     ? fmt::format("tolerance {:g}", options.tolerance)
                     : schedule_names()[static_cast<size_t>(options.schedule.schedule)];
  row.budget = is_adaptive(options.solver) ? 0 : options.evaluations;
  const auto times = solver_times(options);
  row.seconds = std::numeric_limits<double>::infinity();
  SolveReport report;
  for (int timing = 0; timing < kTimings; ++timing) {
    MixtureBranches branches(problem.mixture, problem.conditional_components);
    GuidedField field(branches, guidance_of(problem));
    const auto start = std::chrono::steady_clock::now();
    report = try_solve_on(field, problem.noise, options, times, {problem.name, {}});
    row.seconds = std::min(row.seconds, seconds_since(start));
  }
  row.evaluations = report.evaluations;
  row.accepted = report.accepted;
  row.rejected = report.rejected;
  if (report.failure) {
    row.error_rms = row.error_max = std::numeric_limits<double>::quiet_NaN();
    row.non_finite = report.failure->kind == SolveFailureKind::kNonFinite ? 1 : 0;
  } else {
    const auto error = flow_error(problem, report.state);
    row.error_rms = error.rms;
    row.error_max = error.largest;
  }
  return row;
}

std::vector<SolverRow> sweep_solvers(const FlowProblem& problem, const SolverBenchmarkOptions& benchmark) {
  std::vector<SolverRow> rows;
  SolverOptions options;
  options.schedule.shift = benchmark.shift;
  for (size_t i = 0; i < solver_names().size(); ++i) {
    options.solver = static_cast<SolverKind>(i);
    if (is_stochastic(options.solver) || options.solver == SolverKind::kRodas3) continue;
    if (is_adaptive(options.solver)) {
      options.schedule.schedule = ScheduleKind::kLogSnr;
      for (const double tolerance : benchmark.tolerances) {
        options.tolerance = tolerance;
        rows.push_back(solve_problem(problem, options));
      }
      continue;
    }
    for (const ScheduleKind schedule : swept_schedules()) {
      options.schedule.schedule = schedule;
      for (const int64_t count : benchmark.counts) {
        options.evaluations = count;
        rows.push_back(solve_problem(problem, options));
        stop_if_interrupted(fmt::format("{}: {} solves", problem.name, rows.size()));
      }
    }
  }
  return rows;
}

Table solver_table(const std::vector<SolverRow>& rows) {
  Table table({"problem", "solver", "schedule", "evaluations", "accepted", "rejected", "seconds", "error_rms",
               "error_max", "non_finite"});
  for (const auto& row : rows) {
    table.add_row({row.problem, row.solver, row.schedule, row.evaluations, row.accepted, row.rejected,
                   row.seconds, row.error_rms, row.error_max, row.non_finite});
  }
  return table;
}

int run_solver_benchmark(const SolverBenchmarkOptions& options) {
  const at::NoGradGuard no_grad;
  RunFolder folder(options.out, "bench solvers", options, earlier_run(options.overwrite));
  const auto start = std::chrono::steady_clock::now();
  const auto mixture = benchmark_problem(options);
  std::vector<FlowProblem> problems{mixture};
  SingleGaussianOptions gaussian;
  for (const double width : {1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6}) {
    gaussian.width = width;
    problems.push_back(single_gaussian_problem(gaussian));
  }

  std::vector<SolverRow> rows;
  Progress progress("bench solvers", static_cast<int64_t>(problems.size()) + 1);
  for (size_t i = 0; i < problems.size(); ++i) {
    const auto swept = sweep_solvers(problems[i], options);
    rows.insert(rows.end(), swept.begin(), swept.end());
    progress.update(static_cast<int64_t>(i) + 1, problems[i].name);
  }
  SolverOptions published;
  published.solver = SolverKind::kEuler;
  published.schedule.schedule = ScheduleKind::kPublished;
  published.schedule.shift = options.shift;
  published.evaluations = kPublishedEvaluations;
  const auto published_row = solve_problem(mixture, published);
  const auto targets = default_rows(mixture);
  Table unseen({"problem", "dimensions", "guidance_scale", "6", "12", "16", "20", "published 49"});
  for (const auto& problem : unseen_problems()) {
    std::vector<TableCell> cells{problem.name, problem.noise.size(1), problem.guidance_scale};
    for (const auto& row : default_rows(problem)) {
      cells.emplace_back(row.error_rms);
      rows.push_back(row);
    }
    rows.push_back(solve_problem(problem, published));
    cells.emplace_back(rows.back().error_rms);
    unseen.add_row(cells);
  }
  const auto guidance = guidance_table(mixture);
  const auto stochastic = stochastic_table();
  progress.update(static_cast<int64_t>(problems.size()) + 1, "unseen mixtures, guidance");
  progress.finish();

  const bool targeted = !options.problem.empty() && sha256_of_file(options.problem) == kTargetedProblem;
  const auto text = report_text(rows, targeted ? targeted_text(targets) : untargeted_text(targets), unseen,
                                guidance, stochastic);
  const SolverOptions defaults;
  BenchmarkResults results;
  results.text = text;
  results.files = {{"solvers.csv", solver_table(rows).csv()},
                   {"guidance.csv", guidance.csv()},
                   {"stochastic.csv", stochastic.csv()},
                   {"solvers.md", text}};
  results.figures = {{"work_precision", work_precision_figure(rows)},
                     {"schedules", schedule_figure(rows)},
                     {"widths", width_figure(rows)}};
  results.report = {{"command", "bench solvers"},
                    {"options", to_json(options)},
                    {"default_solver", solver_names()[static_cast<size_t>(defaults.solver)]},
                    {"default_schedule", schedule_names()[static_cast<size_t>(defaults.schedule.schedule)]},
                    {"targets", targeted ? target_report(targets) : nlohmann::ordered_json::array()},
                    {"published_error_rms", published_row.error_rms},
                    {"rows", rows.size()},
                    {"seconds", seconds_since(start)}};
  results.notes = {{"every solve", "solvers.csv"},
                   {"tables", "solvers.md"},
                   {"error against work", "work_precision.png"},
                   {"schedules", "schedules.png"},
                   {"narrow data", "widths.png"}};
  return finish_measured_benchmark(folder, results);
}

}  // namespace gld
