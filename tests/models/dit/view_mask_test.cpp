// Leaving view pairs out of the attention of a DiT^DH: what is computed, and that it costs less.
#include "gld/attention/attention.h"
#include "models/dit/dit_field.h"
#include "tests/support/small_dit.h"

#include <algorithm>
#include <chrono>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::random_dit;
using test::random_dit_scene;
using test::relative_difference;
using test::small_cascade_options;
using test::small_dit_options;

torch::Tensor guided(const DitDh& model, const test::DitTestScene& scene, bool batched) {
  const torch::NoGradGuard no_grad;
  DitField field(model, model.prepare_scene(scene.inputs));
  field.set_batched(batched);
  return field.guided(scene.noisy, 0.4, 1.5);
}

TEST(ViewMask, AllPairsAreTheUnmaskedModelBitForBit) {
  for (const auto& options : {small_dit_options(), small_cascade_options()}) {
    const auto model = random_dit(options);
    auto scene = random_dit_scene(options, {4, 2, 70, 56});
    auto masked = scene;
    masked.inputs.view_mask = torch::ones({4, 4}, torch::kBool);
    for (const bool batched : {false, true}) {
      EXPECT_TRUE(torch::equal(guided(*model, scene, batched), guided(*model, masked, batched))) << batched;
    }
  }
}

TEST(ViewMask, GroupsOfViewsThatDoNotMeetAreModelsOfTheirOwn) {
  // Views 0 and 2, and views 1 and 3, each with a source: the two scenes alone, but for the frame and unit of the
  // cameras, which are those of all four views. The unconditional branch does not see cameras.
  const auto model = random_dit(small_dit_options());
  auto scene = random_dit_scene(model->options(), {4, 2, 42, 28});
  scene.inputs.view_mask = torch::zeros({4, 4}, torch::kBool);
  for (const auto& [a, b] : {std::pair{0, 2}, {1, 3}}) {
    for (const int i : {a, b}) {
      for (const int j : {a, b}) scene.inputs.view_mask[i][j] = true;
    }
  }
  const torch::NoGradGuard no_grad;
  const auto time = model->time_rows({0.5}).front();
  const auto together =
      model->velocity(model->prepare_scene(scene.inputs), scene.noisy, time, DitBranch::kUnconditional);
  for (int64_t group = 0; group < 2; ++group) {
    DitSceneInputs alone;
    alone.views.num_sources = 1;
    for (const int64_t view : {group, group + 2}) {
      alone.views.cameras.push_back(scene.inputs.views.cameras[static_cast<size_t>(view)]);
    }
    alone.source_features = scene.inputs.source_features.narrow(0, group, 1);
    const auto views = torch::tensor({group, group + 2});
    const auto velocity = model->velocity(model->prepare_scene(alone), scene.noisy.index_select(0, views),
                                          time, DitBranch::kUnconditional);
    EXPECT_LT(relative_difference(together.index_select(0, views), velocity), 2e-6);
  }
}

TEST(ViewMask, BatchedBranchesSeeTheSamePairs) {
  const auto model = random_dit(small_dit_options());
  auto scene = random_dit_scene(model->options(), {4, 2, 42, 28});
  const auto unmasked = guided(*model, scene, false);
  scene.inputs.view_mask = torch::eye(4, torch::kBool);
  const auto masked = guided(*model, scene, false);
  EXPECT_GT(relative_difference(masked, unmasked), 1e-3);
  EXPECT_LT(relative_difference(guided(*model, scene, true), masked), 2e-6);
}

TEST(ViewMask, LeftOutBlocksAreNotComputed) {
  // Eight views that see only themselves: an eighth of the products. Less than half of the time, on any machine.
  constexpr int64_t kViews = 8;
  const torch::NoGradGuard no_grad;
  torch::manual_seed(3);
  AttentionInputs inputs;
  for (auto* tensor : {&inputs.query, &inputs.key, &inputs.value})
    *tensor = torch::randn({1, kViews * 120, 4, 64});
  const auto seconds = [&](const torch::Tensor& mask) {
    inputs.view_mask = mask;
    attention(inputs);
    double best = std::numeric_limits<double>::infinity();
    for (int i = 0; i < 7; ++i) {
      const auto start = std::chrono::steady_clock::now();
      attention(inputs);
      best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    }
    return best;
  };
  EXPECT_LT(seconds(torch::eye(kViews, torch::kBool)),
            0.5 * seconds(torch::ones({kViews, kViews}, torch::kBool)));
}

}  // namespace
}  // namespace gld
