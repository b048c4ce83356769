#include "gld/flow/problems/stiff_problems.h"

#include "gld/flow/solvers/solver.h"

#include <cmath>
#include <map>

#include <gtest/gtest.h>

namespace gld {
namespace {

// The L-stable method solves every problem at a coarse and a finer tolerance. That pins down the reference solutions as
// well: they come from closed forms and from other programs.
TEST(StiffProblems, Rodas3SolvesAll) {
  for (const auto& problem : stiff_problems()) {
    for (const double tolerance : {1e-3, 1e-5}) {
      SolverOptions options;
      options.solver = SolverKind::kRodas3;
      options.tolerance = tolerance;
      options.max_evaluations = 50000;
      const auto report = try_solve_on(*problem.field, problem.start, options, {1, 0});
      ASSERT_FALSE(report.failure.has_value()) << problem.name;
      EXPECT_LT(stiff_error(problem, report.state), 10 * tolerance) << problem.name << " " << tolerance;
      EXPECT_LT(report.evaluations, 12000) << problem.name;
    }
  }
}

// Explicit methods cannot finish the stiff ones: they must say so instead of returning numbers.
TEST(StiffProblems, ExplicitMethodsReportFailure) {
  std::map<std::string, int> failures;
  for (const auto& problem : stiff_problems()) {
    for (const SolverKind solver : {SolverKind::kBogackiShampine, SolverKind::kDormandPrince}) {
      SolverOptions options;
      options.solver = solver;
      options.tolerance = 1e-6;
      options.max_evaluations = 5000;
      const auto report = try_solve_on(*problem.field, problem.start, options, {1, 0});
      if (report.failure) {
        ++failures[problem.name];
        EXPECT_GT(report.failure->time, 0);
      } else {
        EXPECT_LT(stiff_error(problem, report.state), 1e-4) << problem.name;
      }
    }
  }
  for (const char* name :
       {"prothero_robinson_1e4", "prothero_robinson_1e6", "linear", "van_der_pol", "rober"}) {
    EXPECT_EQ(failures[name], 2) << name;
  }
  EXPECT_EQ(failures["narrow_mixture_1e-2"], 0);
  EXPECT_EQ(failures["narrow_mixture_1e-4"], 0);
}

TEST(StiffProblems, FixedStepsThatOverflowStop) {
  for (const auto& problem : stiff_problems()) {
    if (problem.name != "van_der_pol" && problem.name != "linear") continue;
    SolverOptions options;
    options.solver = SolverKind::kEuler;
    options.schedule.schedule = ScheduleKind::kUniform;
    options.evaluations = 500;
    const auto report = try_solve_on(*problem.field, problem.start, options, solver_times(options));
    ASSERT_TRUE(report.failure.has_value()) << problem.name;
    EXPECT_EQ(report.failure->kind, SolveFailureKind::kNonFinite);
  }
}

}  // namespace
}  // namespace gld
