// Leaving view pairs out of the attention of a DiT^DH: what is computed and what is not.
#include "gld/attention/attention.h"
#include "models/dit/dit_field.h"
#include "tests/support/small_dit.h"

#include <limits>
#include <vector>

#include <torch/autograd.h>

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

// What is left out is not multiplied by zero, which would make NaN of NaN. How much time that saves, gld bench tells.
// It is the first view that is left out: the last rows of a view may be padded with those of the next one, times zero.
TEST(ViewMask, LeftOutBlocksAreNotComputed) {
  const auto model = random_dit(small_dit_options());
  auto scene = random_dit_scene(model->options(), {4, 2, 42, 28});
  scene.inputs.view_mask = torch::eye(4, torch::kBool);
  const auto expected = guided(*model, scene, false);
  scene.noisy[0].fill_(std::numeric_limits<float>::quiet_NaN());
  const auto found = guided(*model, scene, false);
  EXPECT_TRUE(torch::equal(found.narrow(0, 1, 3), expected.narrow(0, 1, 3)));
  EXPECT_TRUE(found[0].isnan().all().item<bool>());
  // Gradients too: of queries, keys and values of the views that do not meet the first one.
  AttentionInputs inputs;
  std::vector<torch::Tensor> wanted;
  for (auto* tensor : {&inputs.query, &inputs.key, &inputs.value}) {
    *tensor = torch::randn({1, 4 * 30, 2, 16});
    tensor->narrow(1, 0, 30).fill_(std::numeric_limits<float>::quiet_NaN());
    wanted.push_back(tensor->requires_grad_(true));
  }
  inputs.view_mask = scene.inputs.view_mask;
  for (const auto& gradient : torch::autograd::grad({attention(inputs).sum()}, wanted)) {
    EXPECT_TRUE(gradient.narrow(1, 30, 90).isfinite().all().item<bool>());
    EXPECT_TRUE(gradient.narrow(1, 0, 30).isnan().any().item<bool>());
  }
}

}  // namespace
}  // namespace gld
