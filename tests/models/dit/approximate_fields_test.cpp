#include "gld/base/configuration.h"
#include "models/dit/approximate_savings.h"
#include "models/dit/encoder_nodes.h"
#include "models/dit/node_field.h"
#include "tests/support/error_of.h"
#include "tests/support/small_dit.h"

#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::random_dit;
using test::random_dit_scene;
using test::small_cascade_options;
using test::small_dit_options;

SolverOptions default_solver(int64_t evaluations) {
  SolverOptions solver;
  solver.evaluations = evaluations;
  return solver;
}

double relative_rms(const torch::Tensor& a, const torch::Tensor& b) {
  return ((a - b).norm() / b.norm()).item<double>();
}

TEST(EncoderNodes, AreChosenAmongTheTimesThatAreVisited) {
  const auto solver = default_solver(16);
  const auto times = solver_times(solver);
  const auto nodes = encoder_nodes(solver, GuidanceOptions(), 6);
  for (const auto& branch : nodes) {
    ASSERT_EQ(branch.size(), 6U);
    EXPECT_EQ(branch.front(), times.front());
    EXPECT_EQ(branch.back(), times[times.size() - 2]);  // nothing is evaluated at the last time
    for (const double node : branch) EXPECT_EQ(std::count(times.begin(), times.end(), node), 1);
    EXPECT_TRUE(std::is_sorted(branch.rbegin(), branch.rend()));
  }
  const std::vector<double> visited(times.begin(), times.end() - 1);
  EXPECT_EQ(encoder_nodes(solver, GuidanceOptions(), 16)[0], visited);
  EXPECT_EQ(encoder_nodes(solver, GuidanceOptions(), 40)[1], visited);
}

TEST(EncoderNodes, TheUnconditionalBranchHasThemWhereGuidanceActs) {
  GuidanceOptions guidance;
  guidance.guidance_interval = {0.9, 1};
  const auto nodes = encoder_nodes(default_solver(16), guidance, 4);
  EXPECT_EQ(nodes[1].size(), 4U);
  for (const double node : nodes[1]) EXPECT_GE(node, 0.9);
  guidance.guidance_scale = 1;
  EXPECT_TRUE(encoder_nodes(default_solver(16), guidance, 4)[1].empty());
}

TEST(EncoderNodes, AdaptiveAndStagedSolversGetTheWholeInterval) {
  for (const SolverKind kind : {SolverKind::kDormandPrince, SolverKind::kHeun}) {
    auto solver = default_solver(16);
    solver.solver = kind;
    const auto nodes = encoder_nodes(solver, GuidanceOptions(), 5);
    ASSERT_EQ(nodes[0].size(), 5U);
    EXPECT_EQ(nodes[0].front(), 1);
    EXPECT_NEAR(nodes[0][2], 0.5, 1e-15);
    EXPECT_EQ(nodes[0].back(), 0);  // both evaluate at the last time too
  }
}

TEST(EncoderNodes, WeightsInterpolatePolynomials) {
  const auto nodes = encoder_nodes(default_solver(16), GuidanceOptions(), 6)[0];
  for (const double t : {0.999, 0.5, 0.31, 0.02}) {
    const auto weights = interpolation_weights(nodes, t);
    EXPECT_NEAR(std::accumulate(weights.begin(), weights.end(), 0.0), 1, 1e-14);
    double value = 0;
    for (size_t i = 0; i < nodes.size(); ++i) value += weights[i] * std::pow(nodes[i] - 0.3, 5);
    EXPECT_NEAR(value, std::pow(t - 0.3, 5), 1e-13) << t;
  }
  EXPECT_EQ(interpolation_weights(nodes, nodes[2])[2], 1);
  EXPECT_EQ(interpolation_weights({0.4}, 0.4), std::vector<double>{1});
}

class ApproximateFields : public testing::Test {
 protected:
  void build(const DitOptions& options) {
    model_ = random_dit(options);
    // Waves of the published kind turn several times between 0 and 1; these keep to what a trained model does.
    const torch::NoGradGuard no_grad;
    model_->named_parameters()["t_embedder.W"].mul_(0.3);
    scene_ = random_dit_scene(options, {3, 1, 28, 28});
  }
  DitScene prepared() const {
    const torch::NoGradGuard no_grad;
    return model_->prepare_scene(scene_.inputs);
  }
  torch::Tensor solved(DitField& field, const SolverOptions& solver,
                       const GuidanceOptions& guidance = {}) const {
    GuidedField guided(field, guidance);
    return solve(guided, scene_.noisy, solver).state;
  }

  std::shared_ptr<DitDh> model_;
  test::DitTestScene scene_;
};

TEST_F(ApproximateFields, NodesConvergeToTheExactEncoder) {
  build(small_cascade_options());
  const auto solver = default_solver(20);
  DitField exact(*model_, prepared());
  const auto expected = solved(exact, solver);
  double previous = 1e9;
  for (const int64_t count : {2, 5, 9, 14}) {
    NodeField field(*model_, prepared(), encoder_nodes(solver, GuidanceOptions(), count));
    const double error = relative_rms(solved(field, solver), expected);
    EXPECT_LT(error, previous) << count;
    EXPECT_EQ(field.counts().condition_encoder, 2 * count);
    EXPECT_EQ(field.counts().velocity_decoder, 40);
    previous = error;
  }
  EXPECT_LT(previous, 1e-4);
  NodeField all(*model_, prepared(), encoder_nodes(solver, GuidanceOptions(), 20));
  EXPECT_LT(relative_rms(solved(all, solver), expected), 1e-6);
}

TEST_F(ApproximateFields, NodesServeBatchedBranchesAndIntervals) {
  build(small_cascade_options());
  const auto solver = default_solver(12);
  GuidanceOptions guidance;
  guidance.guidance_interval = {0.9, 1};
  const auto nodes = encoder_nodes(solver, guidance, 6);
  NodeField one_by_one(*model_, prepared(), nodes), batched(*model_, prepared(), nodes);
  batched.set_batched(true);
  const auto expected = solved(one_by_one, solver, guidance);
  EXPECT_LT(relative_rms(solved(batched, solver, guidance), expected), 1e-5);
  EXPECT_EQ(one_by_one.counts().condition_encoder, 6 + static_cast<int64_t>(nodes[1].size()));
  EXPECT_EQ(batched.counts().condition_encoder, one_by_one.counts().condition_encoder);
}

TEST_F(ApproximateFields, NodesServeAdaptiveSolvers) {
  build(small_cascade_options());
  SolverOptions solver;
  solver.solver = SolverKind::kDormandPrince;
  solver.tolerance = 1e-3;
  DitField exact(*model_, prepared());
  const auto expected = solved(exact, solver);
  NodeField field(*model_, prepared(), encoder_nodes(solver, GuidanceOptions(), 14));
  EXPECT_LT(relative_rms(solved(field, solver), expected), 0.01);
  EXPECT_EQ(field.counts().condition_encoder, 28);
}

TEST_F(ApproximateFields, AnEncoderThatSeesTheNoisyLatentHasNoNodes) {
  build(small_dit_options());
  EXPECT_EQ(test::error_of([&] {
              NodeField(*model_, prepared(), encoder_nodes(default_solver(8), GuidanceOptions(), 4));
            }),
            "cascade_encoder_nodes: expected a cascade whose condition encoder sees the flow time alone, "
            "found a model whose condition encoder sees the noisy latent too; leave it at 0.");
}

TEST(ApproximateSavings, AreOffAndChecked) {
  ApproximateSavings savings;
  EXPECT_FALSE(savings.any());
  apply_setting(savings, "cascade_encoder_nodes", "6", "--cascade-encoder-nodes");
  EXPECT_TRUE(savings.any());
  ApproximateSavings read;
  load_yaml_text(read, to_yaml(savings), "text");
  EXPECT_EQ(read.cascade_encoder_nodes, 6);
  savings.cascade_encoder_nodes = 1;
  EXPECT_EQ(
      test::error_of([&] { savings.check(); }),
      "cascade_encoder_nodes: expected at least 2 flow times to interpolate between, or 0 for all, found 1; "
      "write for example 6.");
}

}  // namespace
}  // namespace gld
