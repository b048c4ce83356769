// Observed orders of convergence, in double, on a flow with an exact solution.
#include "gld/flow/problems/exact_flows.h"
#include "gld/flow/solvers/solver.h"

#include <cmath>
#include <functional>

#include <gtest/gtest.h>

namespace gld {
namespace {

// A flow to two Gaussians between two times inside (0, 1); nonlinear, so that no method is better than it should be.
struct InteriorFlow {
  double start = 0.8, end = 0.25;
  MixtureField field{{torch::tensor({-0.4, 0.9}, torch::kFloat64).view({2, 1}),
                      torch::tensor({0.36, 0.25}, torch::kFloat64).view({2, 1}),
                      torch::ones({2}, torch::kFloat64)}};
  torch::Tensor state = torch::tensor({-1.3, 0.4, 2.0}, torch::kFloat64).view({3, 1});

  torch::Tensor solution() {
    SolverOptions options;
    options.solver = SolverKind::kDormandPrince;
    options.tolerance = 1e-13;
    options.max_evaluations = 1000000;
    return solve_on(field, state, options, {start, end}).state;
  }
  double error(const torch::Tensor& other) {
    static const torch::Tensor exact = solution();
    return (other - exact).abs().max().item<double>();
  }
};

std::vector<double> grid(const InteriorFlow& flow, int steps, bool in_log_snr) {
  const auto forward = [&](double t) { return in_log_snr ? std::log((1 - t) / t) : t; };
  const auto back = [&](double x) { return in_log_snr ? 1 / (1 + std::exp(x)) : x; };
  std::vector<double> times;
  for (int i = 0; i <= steps; ++i) {
    const double x = static_cast<double>(i) / steps;
    // Unequal steps, so that weights for equal steps would fail.
    const double bent = x + 0.1 * x * (1 - x);
    times.push_back(back(forward(flow.start) + bent * (forward(flow.end) - forward(flow.start))));
  }
  return times;
}

double error_of(SolverKind solver, int steps, bool in_log_snr) {
  InteriorFlow flow;
  SolverOptions options;
  options.solver = solver;
  options.evaluations = 1000000;
  const auto report = solve_on(flow.field, flow.state, options, grid(flow, steps, in_log_snr));
  EXPECT_EQ(report.accepted, steps);
  return flow.error(report.state);
}

struct OrderCase {
  SolverKind solver;
  double order;
  double margin;
  bool in_log_snr;
  int steps;
};

class SolverOrder : public testing::TestWithParam<OrderCase> {};

TEST_P(SolverOrder, MatchesTheory) {
  const auto& expected = GetParam();
  const double coarse = error_of(expected.solver, expected.steps, expected.in_log_snr);
  const double fine = error_of(expected.solver, 2 * expected.steps, expected.in_log_snr);
  EXPECT_NEAR(std::log2(coarse / fine), expected.order, expected.margin)
      << solver_names()[static_cast<size_t>(expected.solver)] << " " << coarse << " " << fine;
}

INSTANTIATE_TEST_SUITE_P(Families, SolverOrder,
                         testing::Values(OrderCase{SolverKind::kEuler, 1, 0.1, false, 160},
                                         OrderCase{SolverKind::kHeun, 2, 0.1, false, 160},
                                         OrderCase{SolverKind::kMidpoint, 2, 0.1, false, 160},
                                         OrderCase{SolverKind::kRungeKutta4, 4, 0.2, false, 40},
                                         OrderCase{SolverKind::kAdamsBashforth2, 2, 0.1, false, 320},
                                         OrderCase{SolverKind::kAdamsBashforth3, 3, 0.2, false, 320},
                                         OrderCase{SolverKind::kDpmSolver1, 1, 0.1, true, 160},
                                         OrderCase{SolverKind::kDpmSolver2M, 2, 0.1, true, 320},
                                         OrderCase{SolverKind::kDpmSolver3M, 3, 0.2, true, 640},
                                         OrderCase{SolverKind::kUniPc2, 3, 0.2, true, 320},
                                         OrderCase{SolverKind::kUniPc3, 3, 0.2, true, 320}),
                         [](const testing::TestParamInfo<OrderCase>& info) {
                           return solver_names()[static_cast<size_t>(info.param.solver)];
                         });

// The error of an adaptive solver follows its tolerance, and evaluations grow as tolerance^(-1/order).
TEST(AdaptiveSolver, ErrorFollowsTheTolerance) {
  InteriorFlow flow;
  for (const SolverKind solver :
       {SolverKind::kBogackiShampine, SolverKind::kDormandPrince, SolverKind::kRodas3}) {
    for (const double tolerance : {1e-3, 1e-5, 1e-7, 1e-9}) {
      SolverOptions options;
      options.solver = solver;
      options.tolerance = tolerance;
      options.max_evaluations = 1000000;
      const auto report = solve_on(flow.field, flow.state, options, {flow.start, flow.end});
      EXPECT_LT(flow.error(report.state), 5 * tolerance) << solver_names()[static_cast<size_t>(solver)];
      EXPECT_DOUBLE_EQ(report.times.back(), flow.end);
      EXPECT_EQ(report.times.size(), static_cast<size_t>(report.accepted) + 1);
    }
  }
}

// By FSAL an accepted or rejected step costs stages - 1 evaluations; two more start the solve.
TEST(AdaptiveSolver, ReusesTheLastStage) {
  InteriorFlow flow;
  for (const auto& [solver, stages] :
       {std::pair{SolverKind::kBogackiShampine, 3}, {SolverKind::kDormandPrince, 6}}) {
    SolverOptions options;
    options.solver = solver;
    options.tolerance = 1e-6;
    const auto report = solve_on(flow.field, flow.state, options, {flow.start, flow.end});
    EXPECT_EQ(report.evaluations, 2 + stages * (report.accepted + report.rejected));
  }
}

}  // namespace
}  // namespace gld
