#pragma once

#include "gld/base/options.h"
#include "gld/flow/problems/exact_flows.h"
#include "gld/flow/solvers/solver.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// gld bench solvers measures error against evaluations and time on flows whose solution is known.
struct SolverBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  // A problem file (gld/flow/problems/exact_flows.h); its rows are named "mixture" whatever the file is called. Empty:
  // the built-in mixture of 48 dimensions, solved to 1e-9 before the sweep.
  std::string problem;
  std::vector<int64_t> counts{4, 6, 8, 12, 16, 20, 32, 49};
  std::vector<double> tolerances{1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7};
  double shift = ScheduleOptions().shift;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// One solve.
struct SolverRow {
  std::string problem;
  std::string solver;
  std::string schedule;  // "tolerance 1e-04" for adaptive solvers
  int64_t evaluations = 0;
  int64_t accepted = 0;
  int64_t rejected = 0;
  double seconds = 0;    // the shortest of three solves
  double error_rms = 0;  // NaN where the solve stopped early
  double error_max = 0;
  int64_t non_finite = 0;  // 1 where it stopped at a value that was not finite
  int64_t budget = 0;      // the evaluations asked for; 0 for adaptive solvers (not in the CSV)
};

// Returns the problem that the options name: the file's, or the built-in one.
FlowProblem benchmark_problem(const SolverBenchmarkOptions& options);

// Solves a problem with its guidance.
SolverRow solve_problem(const FlowProblem& problem, const SolverOptions& options);

// Runs every fixed-step solver on every schedule with every count, and the adaptive ones at every tolerance.
std::vector<SolverRow> sweep_solvers(const FlowProblem& problem, const SolverBenchmarkOptions& options);

// The table has columns problem, solver, schedule, evaluations, accepted, rejected, seconds, error_rms, error_max,
// non_finite.
Table solver_table(const std::vector<SolverRow>& rows);

// Writes solvers.csv, solvers.md, guidance.csv, stochastic.csv, report.json and the plots into options.out. Returns the
// exit status: 0, also where a target is missed (the report says so).
int run_solver_benchmark(const SolverBenchmarkOptions& options);

}  // namespace gld
