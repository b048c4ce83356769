#include "models/dit_field.h"

#include "gld/solver.h"
#include "tests/models/small_dit.h"
#include "tests/support/shared_data.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::random_dit;
using test::random_dit_scene;
using test::relative_difference;
using test::small_dit_options;

DitOptions cascade_options() {
  auto options = small_dit_options();
  options.conditioning = DitConditioning::kDeeperLevel;
  return options;
}

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
  for (const auto& options : {small_dit_options(), cascade_options()}) {
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
  EXPECT_EQ(guided.report().outside_interval, 3);
}

TEST_F(DitFieldTest, CascadeUsesItsConditionAgainAtAnEqualTime) {
  build(cascade_options());
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
  auto special = cascade_options();
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
  for (const auto& options : {small_dit_options(), cascade_options()}) {
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
