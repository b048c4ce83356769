#pragma once

#include "gld/base/options.h"
#include "gld/flow/problems/stiff_problems.h"
#include "gld/flow/solvers/solver.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench stiff measures which solver finishes which stiff problem, and how the others fail.
struct StiffBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  std::vector<double> tolerances{1e-3, 1e-6, 1e-9};
  int64_t max_evaluations = 50000;
  int64_t fixed_evaluations = 2000;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// A solve counts as finished only where its error is known to be small; a failure carries no error, so that no wrong
// number can be mistaken for a result.
struct StiffRow {
  std::string problem;
  std::string solver;
  double tolerance = 0;  // 0 for fixed-step solvers
  std::string
      outcome;  // "finished", "inaccurate: error 0.3", "evaluation limit at time 0.8", "non-finite at step 7, ...", ...
  bool finished = false;
  int64_t evaluations = 0;
  int64_t accepted = 0;
  int64_t rejected = 0;
  double seconds = 0;
  double error = 0;  // RMS of (x - solution)/scale; NaN unless finished
};

// A solve is finished with an error of at most 100 tolerances, or of at most 0.01 for a fixed-step solver.
StiffRow solve_stiff_problem(const StiffProblem& problem, const SolverOptions& options);

std::vector<StiffRow> stiff_rows(const StiffBenchmarkOptions& options);
Table stiff_table(const std::vector<StiffRow>& rows);

// Writes stiff.csv, stiff.md, stiff.svg, stiff.png and report.json into options.out. Returns the exit status.
int run_stiff_benchmark(const StiffBenchmarkOptions& options);

}  // namespace gld
