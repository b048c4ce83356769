#include "gld/flow/solvers/solver.h"

#include "gld/base/configuration.h"
#include "gld/flow/data_prediction.h"
#include "gld/flow/problems/exact_flows.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

// A field given by a function, counting its calls.
class FunctionField : public VelocityField {
 public:
  explicit FunctionField(std::function<torch::Tensor(const torch::Tensor&, double)> function)
      : function_(std::move(function)) {}
  torch::Tensor velocity(const torch::Tensor& state, double t) override {
    times.push_back(t);
    return function_(state, t);
  }
  std::vector<double> times;

 private:
  std::function<torch::Tensor(const torch::Tensor&, double)> function_;
};

FunctionField constant_data_field(double data) {
  return FunctionField([data](const torch::Tensor& x, double t) { return t > 0 ? (x - data) / t : x * 0; });
}

std::vector<SolverKind> fixed_step_solvers() {
  std::vector<SolverKind> kinds;
  for (size_t i = 0; i < solver_names().size(); ++i) {
    const auto kind = static_cast<SolverKind>(i);
    if (!is_adaptive(kind) && !is_stochastic(kind)) kinds.push_back(kind);
  }
  return kinds;
}

torch::Tensor doubles(const std::vector<double>& values) { return torch::tensor(values, torch::kFloat64); }

// The data is one point: v = (x - data)/t, whose flow is a straight line. Every solver must follow it exactly, also
// where it starts at t = 1 and ends at t = 0, on every schedule.
TEST(Solver, StraightFlowsAreExactAtBothEnds) {
  for (const SolverKind solver : fixed_step_solvers()) {
    for (const ScheduleKind schedule :
         {ScheduleKind::kUniform, ScheduleKind::kShifted, ScheduleKind::kLogSnr, ScheduleKind::kKarras}) {
      for (const int64_t evaluations : {1, 2, 3, 5, 16, 49}) {
        auto field = constant_data_field(0.25);
        SolverOptions options;
        options.solver = solver;
        options.evaluations = evaluations;
        options.schedule.schedule = schedule;
        const auto report = solve(field, doubles({-3, 0.5, 40}), options);
        // A stage at t = 0 itself sees this field's convention there, not its limit.
        if (std::find(field.times.begin(), field.times.end(), 0.0) != field.times.end()) continue;
        EXPECT_LT((report.state - 0.25).abs().max().item<double>(), 1e-12)
            << solver_names()[static_cast<size_t>(solver)] << " " << evaluations;
      }
    }
  }
}

TEST(Solver, CountsEvaluationsAndVisitsTheSchedule) {
  for (const SolverKind solver : fixed_step_solvers()) {
    auto field = constant_data_field(0);
    SolverOptions options;
    options.solver = solver;
    options.evaluations = 24;
    const auto report = solve(field, doubles({1, 2}), options);
    EXPECT_EQ(report.evaluations, 24) << solver_names()[static_cast<size_t>(solver)];
    EXPECT_EQ(report.evaluations, static_cast<int64_t>(field.times.size()));
    EXPECT_EQ(report.times, solver_times(options));
    EXPECT_EQ(report.accepted, static_cast<int64_t>(report.times.size()) - 1);
    EXPECT_EQ(report.rejected, 0);
    EXPECT_EQ(field.times.front(), 1);
  }
}

TEST(Solver, TellsTheObserverWhatDataIsPredicted) {
  int64_t told = 0;
  for (const SolverKind solver : fixed_step_solvers()) {
    auto field = constant_data_field(0.25);
    SolverOptions options;
    options.solver = solver;
    options.evaluations = 6;
    SolveObserver observer;
    observer.on_step = [&](const SolveProgress& progress) {
      // At t = 0 itself this field says nothing of the data.
      if (progress.time > 0) {
        EXPECT_LT((progress.predicted_data() - 0.25).abs().max().item<double>(), 1e-12)
            << solver_names()[static_cast<size_t>(solver)];
        ++told;
      }
      return SolveDecision::kGoOn;
    };
    solve(field, doubles({-3, 0.5, 40}), options, observer);
  }
  EXPECT_GT(told, 20) << "steps of all of them that do not end at 0";
}

// The published sampler: 50 times, 49 Euler steps, stopping above 0.
TEST(Solver, PublishedSamplerIsFortyNineEulerSteps) {
  FunctionField field([](const torch::Tensor& x, double) { return torch::ones_like(x); });
  SolverOptions options;
  options.solver = SolverKind::kEuler;
  options.evaluations = 49;
  options.schedule.schedule = ScheduleKind::kPublished;
  const auto report = solve(field, doubles({0}), options);
  ASSERT_EQ(report.times.size(), 50u);
  EXPECT_EQ(report.evaluations, 49);
  EXPECT_NEAR(report.state.item<double>(), report.times.back() - 1, 1e-14);
  EXPECT_NEAR(report.times.back(), 0.0303, 1e-4);
}

TEST(Solver, KeepsShapeAndDtype) {
  for (const auto dtype : {torch::kFloat32, torch::kFloat64}) {
    for (const SolverKind solver : fixed_step_solvers()) {
      auto field = constant_data_field(0.5);
      SolverOptions options;
      options.solver = solver;
      const auto noise = torch::ones({2, 3, 4}, dtype);
      const auto report = solve(field, noise, options);
      EXPECT_EQ(report.state.scalar_type(), dtype);
      EXPECT_EQ(report.state.sizes(), noise.sizes());
      EXPECT_EQ(noise.sum().item<double>(), 24) << "the noise must not be written to";
    }
  }
}

TEST(Solver, TellsTheObserverEveryStep) {
  auto field = constant_data_field(0);
  SolverOptions options;
  options.evaluations = 7;
  std::vector<SolveProgress> seen;
  SolveObserver observer{"level 1", [&](const SolveProgress& progress) {
                           seen.push_back(progress);
                           return SolveDecision::kGoOn;
                         }};
  EXPECT_FALSE(solve(field, doubles({1}), options, observer).stopped);
  ASSERT_EQ(seen.size(), 7u);
  for (size_t i = 0; i < seen.size(); ++i) {
    EXPECT_EQ(seen[i].step, static_cast<int64_t>(i) + 1);
    EXPECT_EQ(seen[i].steps, 7);
  }
  EXPECT_EQ(seen.back().time, 0);
}

// Every family leaves off after the step at which the observer says so, with what it has until then.
TEST(Solver, StopsWhereTheObserverSaysSo) {
  for (size_t solver = 0; solver < solver_names().size(); ++solver) {
    auto field = constant_data_field(0.5);
    SolverOptions options;
    options.solver = static_cast<SolverKind>(solver);
    options.evaluations = 40;
    options.tolerance = 1e-9;  // so that adaptive solvers take more than two steps
    SolveProgress last;
    SolveObserver observer{"level 1", [&](const SolveProgress& progress) {
                             last = progress;
                             return progress.step == 2 ? SolveDecision::kStop : SolveDecision::kGoOn;
                           }};
    const auto report = solve(field, doubles({1}), options, observer);
    EXPECT_TRUE(report.stopped) << solver_names()[solver];
    EXPECT_FALSE(report.failure);
    EXPECT_EQ(report.accepted, 2) << solver_names()[solver];
    EXPECT_EQ(last.step, 2) << solver_names()[solver];
    EXPECT_EQ(report.times.back(), last.time) << solver_names()[solver];
    EXPECT_GT(last.time, 0) << solver_names()[solver];
  }
}

// And before the evaluation at which it is told so, be that in the middle of a step or in one that is rejected.
TEST(Solver, StopsBeforeAnEvaluationWhereTheObserverSaysSo) {
  for (size_t solver = 0; solver < solver_names().size(); ++solver) {
    int64_t evaluated = 0;
    FunctionField field([&](const torch::Tensor& x, double) {
      ++evaluated;
      return x;
    });
    SolverOptions options;
    options.solver = static_cast<SolverKind>(solver);
    options.evaluations = 40;
    options.tolerance = 1e-9;
    int64_t asked = 0;
    SolveObserver observer{
        "level 1", {}, [&] { return ++asked > 3 ? SolveDecision::kStop : SolveDecision::kGoOn; }};
    const auto report = solve(field, doubles({1}), options, observer);
    EXPECT_TRUE(report.stopped) << solver_names()[solver];
    EXPECT_FALSE(report.failure);
    EXPECT_EQ(evaluated, 3) << solver_names()[solver];
    EXPECT_EQ(report.evaluations, 3) << solver_names()[solver];
  }
}

// A value that is not finite stops with stage, step and time.
TEST(Solver, NamesWhereAValueIsNotFinite) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  FunctionField field([&](const torch::Tensor& x, double t) { return t < 0.6 ? x * nan : x; });
  SolverOptions options;
  options.solver = SolverKind::kEuler;
  options.evaluations = 4;
  options.schedule.schedule = ScheduleKind::kUniform;
  EXPECT_EQ(error_of([&] {
              solve(field, doubles({1, 2}), options, {"level 1", {}});
            }),
            "level 1, step 3, flow time 0.5: expected finite numbers, found NaN or infinity in the velocity; "
            "check the inputs of this stage, lower the guidance scale or take smaller steps.");
  EXPECT_EQ(error_of([&] {
              solve(field, doubles({1, nan}), options, {"cascade", {}});
            }),
            "cascade, step 1, flow time 1: expected finite numbers, found NaN or infinity in the noise; "
            "check the inputs of this stage, lower the guidance scale or take smaller steps.");
  const auto report = try_solve_on(field, doubles({1, 2}), options, {1, 0.75, 0.5, 0.25});
  ASSERT_TRUE(report.failure.has_value());
  EXPECT_EQ(report.failure->kind, SolveFailureKind::kNonFinite);
  EXPECT_EQ(report.accepted, 2);
  EXPECT_EQ(report.times.back(), 0.5);
}

// Finite values whose sum overflows are no failure.
TEST(Solver, LargeFiniteValuesAreFine) {
  FunctionField field([](const torch::Tensor& x, double) { return x * 0; });
  const auto noise = torch::full({8}, 3e38f);
  SolverOptions options;
  options.solver = SolverKind::kEuler;
  EXPECT_EQ(solve(field, noise, options).state[0].item<float>(), 3e38f);
}

TEST(Solver, AdaptiveSolverGivesUpInWords) {
  FunctionField field([](const torch::Tensor& x, double) { return 1e7 * x; });
  SolverOptions options;
  options.solver = SolverKind::kBogackiShampine;
  options.max_evaluations = 200;
  const auto report = try_solve_on(field, doubles({1}), options, {1, 0});
  ASSERT_TRUE(report.failure.has_value());
  EXPECT_EQ(report.failure->kind, SolveFailureKind::kEvaluationLimit);
  EXPECT_EQ(report.evaluations, 200);
  const SolveFailure failure{SolveFailureKind::kEvaluationLimit, "evaluations", 34, 0.9995};
  EXPECT_STREQ(Error(failure.parts("problem")).what(),
               "problem, step 34, flow time 0.9995: "
               "expected the solve to end within max_evaluations, found that more are needed; "
               "raise max_evaluations or the tolerance, or use rodas3 for a small stiff problem.");
}

TEST(Solver, RefusesAStateTooLargeForRodas3) {
  FunctionField field([](const torch::Tensor& x, double) { return x; });
  SolverOptions options;
  options.solver = SolverKind::kRodas3;
  EXPECT_EQ(error_of([&] { solve(field, torch::zeros({600}), options); }),
            "solver rodas3: expected at most 512 unknowns, found 600; "
            "use dp54 or a fixed-step solver for larger states.");
}

TEST(Solver, OptionsNameTheNearestSolver) {
  SolverOptions options;
  EXPECT_NE(error_of([&] { apply_setting(options, "solver=unipc4"); }).find("unipc"), std::string::npos);
  apply_setting(options, "solver=dp54");
  apply_setting(options, "schedule=published");
  EXPECT_EQ(options.solver, SolverKind::kDormandPrince);
  EXPECT_EQ(options.schedule.schedule, ScheduleKind::kPublished);
}

// The weights of the exponential integrator are exact for polynomials in the log-SNR; they are compared with
// quadrature.
TEST(DataPrediction, WeightsIntegratePolynomialsInLogSnr) {
  const auto log_snr = [](double t) { return std::log((1 - t) / t); };
  const double start = 0.6, next = 0.35;
  for (const double end : {next, 0.599, 0.02}) {
    const std::vector<double> nodes{0.6, 0.75, 0.9};
    const auto weights = data_prediction_weights(start, end, nodes);
    for (int degree = 0; degree < 3; ++degree) {
      // t * integral of lambda^degree d rho by Simpson's rule in rho.
      const double low = (1 - start) / start, high = (1 - end) / end;
      const int intervals = 20000;
      double integral = 0;
      for (int i = 0; i <= intervals; ++i) {
        const double rho = low + (high - low) * i / intervals;
        const double factor = i == 0 || i == intervals ? 1 : i % 2 == 1 ? 4 : 2;
        integral += factor * std::pow(std::log(rho), degree);
      }
      integral *= end * (high - low) / intervals / 3;
      double sum = 0;
      for (size_t j = 0; j < nodes.size(); ++j) sum += weights[j] * std::pow(log_snr(nodes[j]), degree);
      EXPECT_NEAR(sum, integral, 1e-9 * std::max(1.0, std::abs(integral))) << end << " " << degree;
    }
  }
}

TEST(DataPrediction, WeightsSumToOneMinusTheRatio) {
  for (const double start : {1.0, 0.999999, 0.5, 1e-3}) {
    for (const double ratio : {0.999999, 0.5, 1e-6, 0.0}) {
      const double next = start * ratio;
      for (const auto& nodes :
           {std::vector<double>{start}, {start, std::min(1.0, start * 1.0000001 + 1e-9)}}) {
        if (nodes.size() == 2 && nodes[1] == nodes[0]) continue;
        const auto weights = data_prediction_weights(start, next, nodes);
        EXPECT_NEAR(std::accumulate(weights.begin(), weights.end(), 0.0), 1 - ratio, 1e-7)
            << start << " " << ratio;
      }
    }
  }
}

// The limits: the weights near the ends approach those at the ends.
TEST(DataPrediction, EndsAreLimits) {
  const auto at_end = data_prediction_weights(0.1, 0, {0.1});
  const auto near_end = data_prediction_weights(0.1, 1e-12, {0.1});
  EXPECT_NEAR(at_end[0], near_end[0], 1e-10);
  const auto at_start = data_prediction_weights(0.5, 0.4, {0.5, 1.0});
  const auto near_start = data_prediction_weights(0.5, 0.4, {0.5, 1 - 1e-15});
  EXPECT_EQ(at_start[1], 0);
  EXPECT_NEAR(at_start[0], near_start[0], 0.01);
}

// The stochastic solvers reach the data's distribution: mean and spread of 10000 samples of one Gaussian.
TEST(StochasticSolver, ReachesTheDistribution) {
  for (const SolverKind solver : {SolverKind::kEulerMaruyama, SolverKind::kStochasticHeun}) {
    for (const DiffusionForm form : {DiffusionForm::kConstant, DiffusionForm::kLinear,
                                     DiffusionForm::kQuadratic, DiffusionForm::kSineSquared}) {
      SingleGaussianOptions gaussian;
      gaussian.samples = 2500;
      const auto problem = single_gaussian_problem(gaussian);
      MixtureField field(problem.mixture);
      SolverOptions options;
      options.solver = solver;
      options.diffusion = form;
      options.evaluations = 120;
      options.schedule.schedule = ScheduleKind::kUniform;
      options.noise_seed = 3;
      const auto state = solve(field, problem.noise, options).state;
      const std::string name =
          solver_names()[static_cast<size_t>(solver)] + " " + std::to_string(static_cast<int>(form));
      EXPECT_NEAR(state.mean().item<double>(), 0.5, 0.03) << name;
      EXPECT_NEAR(state.std().item<double>(), 1, 0.03) << name;
      if (form != DiffusionForm::kLinear) continue;
      EXPECT_TRUE(torch::equal(state, solve(field, problem.noise, options).state)) << "same seed, same bytes";
      options.noise_seed = 4;
      EXPECT_FALSE(torch::equal(state, solve(field, problem.noise, options).state));
    }
  }
}

// A view's noise is another one than that of the views beside it, of other samples and of other levels, and does not
// depend on how many there are.
TEST(StochasticSolver, EveryRowHasNoiseOfItsOwn) {
  SolverOptions options;
  options.solver = SolverKind::kEulerMaruyama;
  options.schedule.schedule = ScheduleKind::kUniform;
  options.evaluations = 4;
  class Still : public VelocityField {
   public:
    torch::Tensor velocity(const torch::Tensor& state, double /*t*/) override {
      return torch::zeros_like(state);
    }
  } field;
  torch::manual_seed(1);
  const auto begin = torch::randn({3, 4000});
  const auto solved = [&](const torch::Tensor& rows) { return solve(field, rows, options).state; };
  EXPECT_TRUE(torch::equal(solved(begin).narrow(0, 2, 1), solved(begin.narrow(0, 2, 1))));
  // What was added to a row: the rest of it is a multiple of what it begins with.
  const auto added = [&](const torch::Tensor& row) {
    const auto end = solved(row.unsqueeze(0))[0];
    return end - end.dot(row) / row.dot(row) * row;
  };
  const auto likeness = [](const torch::Tensor& a, const torch::Tensor& b) {
    return (a.dot(b) / (a.norm() * b.norm())).item<double>();
  };
  EXPECT_GT(added(begin[0]).norm().item<double>(), 10);
  EXPECT_NEAR(likeness(added(begin[0]), added(begin[1])), 0, 0.06);
  EXPECT_NEAR(likeness(added(begin[0]), added(begin[0] + 1e-3F)), 0, 0.06);
}

// Without noise strength both are the deterministic solvers.
TEST(StochasticSolver, WithoutNoiseFollowsTheFlow) {
  const auto problem = single_gaussian_problem({});
  MixtureField field(problem.mixture);
  SolverOptions options;
  options.diffusion_strength = 0;
  options.solver = SolverKind::kEulerMaruyama;
  const auto stochastic = solve(field, problem.noise, options).state;
  options.solver = SolverKind::kEuler;
  EXPECT_TRUE(torch::allclose(stochastic, solve(field, problem.noise, options).state, 1e-12, 1e-12));
}

}  // namespace
}  // namespace gld
