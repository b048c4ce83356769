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
  EXPECT_EQ(field.report().evaluations - field.report().unconditional, 2);
}

// The mix is u + s (c - u): at 0 the unconditional branch, at 1 the conditional one, and beyond it away from the
// unconditional.
TEST(Guidance, MixesTheBranchesByItsScale) {
  CountingBranches branches;
  branches.gap = 4;
  for (const double scale : {0.0, 0.5, 1.0, 3.0}) {
    GuidedField field(branches, guidance_of(scale, 0, 1));
    EXPECT_DOUBLE_EQ(field.velocity(torch::zeros({1}, torch::kFloat64), 0.5).item<double>(), 1 + scale * 2)
        << scale;
  }
}

// A plan counts with what a field does.
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

TEST(Guidance, RefusesAnInvertedInterval) {
  EXPECT_EQ(error_of([] { guidance_of(1.5, 0.9, 0.1).check(); }),
            "guidance_interval: expected two flow times, the lower first, found [0.9, 0.1]; "
            "write for example [0, 1].");
}

}  // namespace
}  // namespace gld
