#include "models/dit/dit_field.h"

#include "gld/flow/solvers/solver.h"
#include "models/cost/branch_choice.h"
#include "models/cost/cost_model.h"
#include "tests/support/error_of.h"
#include "tests/support/small_dit.h"

#include <algorithm>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::random_dit;
using test::random_dit_scene;
using test::relative_difference;
using test::small_cascade_options;
using test::small_dit_options;

class DitFieldTest : public testing::Test {
 protected:
  void build(const DitOptions& options) {
    model_ = random_dit(options);
    scene_ = random_dit_scene(options, {4, 2, 42, 28});
  }
  DitField field(const ExactSavings& savings = {}) const {
    const torch::NoGradGuard no_grad;
    return DitField(*model_, model_->prepare_scene(scene_.inputs, savings));
  }

  std::shared_ptr<DitDh> model_;
  test::DitTestScene scene_;
};

TEST_F(DitFieldTest, GuidanceCombinesTheBranches) {
  auto data = small_dit_options();
  data.prediction = FlowPrediction::kData;
  auto carried = small_cascade_options(), carried_data = data;
  carried.warped_sources = carried_data.warped_sources = 1;
  carried.carried_error = carried_data.carried_error = 0.2;
  auto corrected = carried_data;
  corrected.carried_guess = CarriedGuess::kCorrected;
  for (const auto& options :
       {small_dit_options(), small_cascade_options(), data, carried, carried_data, corrected}) {
    build(options);
    auto dit = field();
    const auto conditional = dit.conditional(scene_.noisy, 0.4);
    const auto unconditional = dit.unconditional(scene_.noisy, 0.4);
    EXPECT_GT(relative_difference(conditional, unconditional), 1e-2);
    const auto both = dit.both(scene_.noisy, 0.4);
    EXPECT_LT(relative_difference(both.conditional, conditional), 1e-6);
    EXPECT_LT(relative_difference(both.unconditional, unconditional), 1e-6);
    for (const double scale : {1.5, 20.0}) {
      const auto expected = unconditional + scale * (conditional - unconditional);
      EXPECT_LT(relative_difference(dit.guided(scene_.noisy, 0.4, scale), expected), 3e-6) << scale;
    }
    EXPECT_FALSE(conditional.requires_grad());
  }
}

TEST_F(DitFieldTest, IntervalEndsAreIncluded) {
  build(small_dit_options());
  auto dit = field();
  GuidanceOptions options;
  options.guidance_scale = 3;
  options.guidance_interval = {0.25, 0.75};
  GuidedField guided(dit, options);
  for (const double t : {0.25, 0.5, 0.75}) {
    EXPECT_LT(relative_difference(guided.velocity(scene_.noisy, t), dit.guided(scene_.noisy, t, 3)), 1e-6)
        << t;
  }
  for (const double t : {0.2499, 0.7501, 1.0}) {
    EXPECT_LT(relative_difference(guided.velocity(scene_.noisy, t), dit.conditional(scene_.noisy, t)), 1e-6)
        << t;
  }
  EXPECT_EQ(guided.report().unconditional, 3);
  EXPECT_EQ(guided.report().evaluations - guided.report().unconditional, 3);
}

TEST_F(DitFieldTest, CascadeUsesItsConditionAgainAtAnEqualTime) {
  build(small_cascade_options());
  auto dit = field();
  const auto first = dit.guided(scene_.noisy, 0.4, 1.5);
  const auto again = dit.guided(scene_.noisy, 0.4, 1.5);
  EXPECT_TRUE(torch::equal(first, again));
  EXPECT_EQ(dit.counts().condition_encoder, 2);
  EXPECT_EQ(dit.counts().encoder_reused, 2);
  EXPECT_EQ(dit.counts().velocity_decoder, 4);
  dit.guided(scene_.noisy, 0.3, 1.5);
  EXPECT_EQ(dit.counts().condition_encoder, 4);

  ExactSavings savings;
  disable_exact_saving(savings, "encoder_reuse");
  auto without = field(savings);
  without.guided(scene_.noisy, 0.4, 1.5);
  EXPECT_LT(relative_difference(without.guided(scene_.noisy, 0.4, 1.5), first), 2e-6);
  EXPECT_EQ(without.counts().condition_encoder, 4);
}

TEST_F(DitFieldTest, ConditionThatSeesTheNoisyLatentIsNeverReused) {
  auto special = small_cascade_options();
  special.num_special_tokens = 2;
  special.in_channels = 48;
  for (const auto& options : {small_dit_options(), special}) {
    build(options);
    auto dit = field();
    dit.conditional(scene_.noisy, 0.4);
    const auto moved = dit.conditional(scene_.noisy + 0.5, 0.4);
    EXPECT_EQ(dit.counts().encoder_reused, 0);
    EXPECT_LT(relative_difference(field().conditional(scene_.noisy + 0.5, 0.4), moved), 1e-6);
  }
}

TEST_F(DitFieldTest, SamplingIsTheSameWithEverySavingOff) {
  for (const auto& options : {small_dit_options(), small_cascade_options()}) {
    build(options);
    SolverOptions solver;
    solver.solver = SolverKind::kEuler;
    solver.evaluations = 5;
    solver.schedule.schedule = ScheduleKind::kPublished;
    solver.schedule.shift = 18;
    const auto sample = [&](const ExactSavings& savings) {
      auto dit = field(savings);
      dit.prepare_times(solver_times(solver));
      GuidanceOptions guidance;
      guidance.guidance_interval = {0.1, 0.98};
      GuidedField guided(dit, guidance);
      return solve(guided, scene_.noisy, solver).state;
    };
    ExactSavings none;
    const auto expected = sample({});
    for (const auto& name : exact_saving_names()) {
      ExactSavings one_off;
      disable_exact_saving(one_off, name);
      disable_exact_saving(none, name);
      EXPECT_LT(relative_difference(sample(one_off), expected), 2e-6) << name;
    }
    EXPECT_LT(relative_difference(sample(none), expected), 2e-6);
    EXPECT_TRUE(torch::equal(sample({}), expected));
  }
}

// Models whose branches differ in every way: level and cascade, special tokens, cameras in the velocity decoder, norms
// of queries and keys, and the released cascade's unconditional intrinsics.
std::vector<DitOptions> varied_options() {
  auto special = small_dit_options();
  special.num_special_tokens = 2;
  special.in_channels = 48;
  auto special_cascade = special;
  special_cascade.conditioning = DitConditioning::kDeeperLevel;
  auto late_cameras = small_dit_options();
  late_cameras.camera_embedding_input = CameraEmbeddingInput::kVelocityDecoder;
  late_cameras.qk_norm = true;
  auto released = small_cascade_options();
  released.unconditional_intrinsics = UnconditionalIntrinsics::kKeep;
  released.split_embedders = false;
  return {small_dit_options(), small_cascade_options(), special, special_cascade, late_cameras, released};
}

struct BatchComparison {
  DitField sequential, batched;
  torch::Tensor noisy;

  BatchComparison(const DitDh& model, const test::DitTestScene& scene, const ExactSavings& savings)
      : sequential(model, model.prepare_scene(scene.inputs, savings)),
        batched(model, model.prepare_scene(scene.inputs, savings)),
        noisy(scene.noisy) {
    batched.set_batched(true);
  }
  // Of both branches and of their guided sum.
  double largest_difference(double t) {
    const auto expected = sequential.both(noisy, t), both = batched.both(noisy, t);
    return std::max({relative_difference(both.conditional, expected.conditional),
                     relative_difference(both.unconditional, expected.unconditional),
                     relative_difference(batched.guided(noisy, t, 1.5), sequential.guided(noisy, t, 1.5))});
  }
};

TEST_F(DitFieldTest, BatchedBranchesEqualSequentialOnes) {
  const torch::NoGradGuard no_grad;
  std::vector<ExactSavings> all_savings(2);
  for (const auto& name : exact_saving_names()) {
    disable_exact_saving(all_savings[1], name);
    ExactSavings one_off;
    disable_exact_saving(one_off, name);
    all_savings.push_back(one_off);
  }
  for (const auto& options : varied_options()) {
    build(options);
    const auto in_double = test::in_double(*model_);
    for (size_t i = 0; i < 2; ++i) {
      BatchComparison exact(*in_double, test::in_double(scene_), all_savings[i]);
      EXPECT_LT(exact.largest_difference(0.4), 1e-12);
    }
    for (size_t i = 0; i < all_savings.size(); ++i) {
      BatchComparison usual(*model_, scene_, all_savings[i]);
      for (const double t : {0.9, 0.4}) {
        // Special tokens meet unencoded projections, whose entries in the unconditional branch span four decades:
        // float32 itself is off by 1e-5 there.
        EXPECT_LT(usual.largest_difference(t), options.num_special_tokens == 0 ? 2e-6 : 1e-4);
      }
      const auto &one = usual.sequential.counts(), &other = usual.batched.counts();
      EXPECT_EQ(other.condition_encoder, one.condition_encoder);
      EXPECT_EQ(other.velocity_decoder, one.velocity_decoder);
      EXPECT_EQ(other.encoder_reused, one.encoder_reused);
      EXPECT_EQ(other.batched, 4);
      EXPECT_EQ(one.batched, 0);
    }
  }
}

TEST_F(DitFieldTest, ABatchTakesTheBranchThatIsThereAlready) {
  build(small_cascade_options());
  auto sequential = field(), batched = field();
  batched.set_batched(true);
  batched.conditional(scene_.noisy, 0.4);
  const auto both = batched.both(scene_.noisy, 0.4);
  EXPECT_EQ(batched.counts().condition_encoder, 2);
  EXPECT_EQ(batched.counts().encoder_reused, 1);
  const auto expected = sequential.both(scene_.noisy, 0.4);
  EXPECT_LT(relative_difference(both.conditional, expected.conditional), 2e-6);
  EXPECT_LT(relative_difference(both.unconditional, expected.unconditional), 2e-6);
}

// What fields that approximate the condition encoder do: they change, keep or replace what it gives.
class HalvedCondition : public DitField {
 public:
  using DitField::DitField;

 protected:
  torch::Tensor condition(const DitNoisyTokens& tokens, const DitTimeRow& time, DitBranch branch) override {
    if (branch == DitBranch::kUnconditional && time.time < 0.5) return torch::ones_like(tokens.encoder);
    return 0.5 * DitField::condition(tokens, time, branch);
  }
};

TEST_F(DitFieldTest, ABatchGoesThroughAnOverriddenCondition) {
  for (const auto& options : {small_dit_options(), small_cascade_options()}) {
    build(options);
    const auto scene = model_->prepare_scene(scene_.inputs);
    HalvedCondition sequential(*model_, scene), batched(*model_, scene);
    batched.set_batched(true);
    for (const double t : {0.9, 0.4}) {
      const auto expected = sequential.both(scene_.noisy, t);
      const auto both = batched.both(scene_.noisy, t);
      EXPECT_LT(relative_difference(both.conditional, expected.conditional), 2e-6) << t;
      EXPECT_LT(relative_difference(both.unconditional, expected.unconditional), 2e-6) << t;
      EXPECT_GT(relative_difference(both.conditional, field().conditional(scene_.noisy, t)), 1e-3) << t;
    }
  }
}

TEST(BranchChoice, AutomaticBatchesSmallScenesWithinTheLimit) {
  const DitOptions options;
  const LatentGrid small{2, 4, 4}, large{8, 36, 36};
  GuidanceOptions guidance;
  EXPECT_TRUE(choose_branches(guidance, options, small).batched);
  EXPECT_FALSE(choose_branches(guidance, options, large).batched);
  EXPECT_EQ(choose_branches(guidance, options, small).working_bytes,
            2 * dit_cost(options, small).working_bytes);
  guidance.guidance_batch_memory = 1;
  EXPECT_FALSE(choose_branches(guidance, options, small).batched);
  guidance.guidance_branches = BranchEvaluation::kSequential;
  EXPECT_FALSE(choose_branches(guidance, options, small).batched);
  guidance.guidance_branches = BranchEvaluation::kBatched;
  guidance.guidance_batch_memory = 0;
  EXPECT_TRUE(choose_branches(guidance, options, large).batched);
}

TEST(ExactSavings, NamesAreChecked) {
  EXPECT_EQ(exact_saving_names().size(), 9U);
  ExactSavings savings;
  disable_exact_saving(savings, "prope_tables_once");
  EXPECT_FALSE(savings.prope_tables_once);
  EXPECT_TRUE(savings.encoder_reuse);
  EXPECT_EQ(
      test::error_of([&] { disable_exact_saving(savings, "prope_table_once"); }),
      "--no-skip: expected one of camera_embedding_once, source_embedding_once, shared_noisy_embedding, "
      "cascade_input_once, encoder_reuse, time_rows_once, prope_tables_once, unconditional_constants, "
      "combined_last_linear, found 'prope_table_once'; write 'prope_tables_once'.");
}

}  // namespace
}  // namespace gld
