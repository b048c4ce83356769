#include "gld/flow/guidance.h"

#include "gld/flow/problems/exact_flows.h"
#include "gld/flow/solvers/solver.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

// Branches that differ by a constant times t, and count their calls.
class CountingBranches : public BranchedField {
 public:
  torch::Tensor conditional(const torch::Tensor& state, double t) override {
    ++conditional_calls;
    return torch::full_like(state, 1 + gap * t);
  }
  torch::Tensor unconditional(const torch::Tensor& state, double) override {
    ++unconditional_calls;
    return torch::ones_like(state);
  }
  double gap = 1;
  int conditional_calls = 0;
  int unconditional_calls = 0;
};

GuidanceOptions guidance_of(double scale, double low, double high) {
  GuidanceOptions options;
  options.guidance_scale = scale;
  options.guidance_interval = {low, high};
  return options;
}

TEST(Guidance, ActsInsideTheIntervalBothEndsIncluded) {
  CountingBranches branches;
  GuidedField field(branches, guidance_of(1.5, 0.25, 0.75));
  const auto state = torch::zeros({2}, torch::kFloat64);
  const auto at = [&](double t) { return field.velocity(state, t)[0].item<double>(); };
  EXPECT_DOUBLE_EQ(at(1.0), 2);
  EXPECT_DOUBLE_EQ(at(0.75), 1 + 1.5 * 0.75);
  EXPECT_DOUBLE_EQ(at(0.5), 1 + 1.5 * 0.5);
  EXPECT_DOUBLE_EQ(at(0.25), 1 + 1.5 * 0.25);
  EXPECT_DOUBLE_EQ(at(0.2), 1.2);
  EXPECT_EQ(branches.unconditional_calls, 3);
  EXPECT_EQ(branches.conditional_calls, 5);
  EXPECT_EQ(field.report().evaluations, 5);
  EXPECT_EQ(field.report().unconditional, 3);
  EXPECT_EQ(field.report().outside_interval, 2);
}

// What a field does is what a plan counts with.
TEST(Guidance, OptionsSayWhereItActs) {
  const auto options = guidance_of(2, 0.25, 0.75);
  EXPECT_TRUE(options.acts_at(0.25));
  EXPECT_TRUE(options.acts_at(0.75));
  EXPECT_FALSE(options.acts_at(0.2499));
  EXPECT_FALSE(options.acts_at(0.7501));
  EXPECT_FALSE(guidance_of(1, 0, 1).acts_at(0.5));
}

TEST(Guidance, ScaleOneNeverRunsTheUnconditionalBranch) {
  CountingBranches branches;
  GuidedField field(branches, guidance_of(1, 0, 1));
  for (const double t : {1.0, 0.5, 0.0}) field.velocity(torch::zeros({2}), t);
  EXPECT_EQ(branches.unconditional_calls, 0);
  EXPECT_EQ(branches.conditional_calls, 3);
}

// The branches of a mixture agree late: what is dropped is counted, and what it changed is small.
TEST(Guidance, DropsTheUnconditionalBranchWhereBranchesAgree) {
  const auto problem = read_flow_problem(test::test_data() / "problems" / "mixture.safetensors", "mixture");
  SolverOptions solver;
  solver.evaluations = 20;
  const auto solved = [&](double tolerance, GuidanceReport& report) {
    MixtureBranches branches(problem.mixture, problem.conditional_components);
    auto options = guidance_of(problem.guidance_scale, 0, 1);
    options.guidance_tolerance = tolerance;
    GuidedField field(branches, options);
    auto state = solve(field, problem.noise, solver).state;
    report = field.report();
    return state;
  };
  GuidanceReport whole, adaptive;
  const auto exact = solved(0, whole), approximate = solved(0.01, adaptive);
  EXPECT_EQ(whole.unconditional, 20);
  EXPECT_EQ(whole.dropped, 0);
  EXPECT_EQ(adaptive.unconditional + adaptive.dropped, 20);
  EXPECT_GE(adaptive.dropped, 8);
  EXPECT_LT(adaptive.largest_neglected, 0.01);
  EXPECT_LT(((approximate - exact) / problem.standard_deviation).square().mean().sqrt().item<double>(), 1e-3);
}

// When the branches part again, the next check brings the unconditional one back.
TEST(Guidance, ChecksAgainAfterDropping) {
  CountingBranches branches;
  auto options = guidance_of(2, 0, 1);
  options.guidance_tolerance = 0.1;
  GuidedField field(branches, options);
  branches.gap = 0;
  const auto state = torch::zeros({4}, torch::kFloat64);
  field.velocity(state, 1);  // measured, agrees
  branches.gap = 1;
  for (int i = 0; i < 3; ++i) EXPECT_DOUBLE_EQ(field.velocity(state, 1)[0].item<double>(), 2);  // dropped
  EXPECT_EQ(branches.unconditional_calls, 1);
  for (int i = 0; i < 5; ++i)
    EXPECT_DOUBLE_EQ(field.velocity(state, 1)[0].item<double>(), 3);  // guided again
  EXPECT_EQ(branches.unconditional_calls, 6);
  EXPECT_EQ(field.report().dropped, 3);
}

TEST(Guidance, RefusesAnInvertedInterval) {
  EXPECT_EQ(error_of([] { guidance_of(1.5, 0.9, 0.1).check(); }),
            "guidance_interval: expected two flow times, the lower first, found [0.9, 0.1]; "
            "write for example [0, 1].");
}

}  // namespace
}  // namespace gld
