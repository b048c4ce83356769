// Several scenes in one evaluation of a DiT^DH against each of them alone.
#include "gld/flow/flow.h"
#include "models/dit/dit_dh.h"
#include "models/dit/flow_matching_loss.h"
#include "tests/support/error_of.h"
#include "tests/support/small_dit.h"

#include <functional>
#include <ostream>
#include <string>
#include <vector>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::random_dit;
using test::random_dit_scene;
using test::relative_difference;
using test::small_cascade_options;
using test::small_dit_options;

// float32 goes through our kernels and rounds its sums in another order for more tokens; float64 shows what is equal.
struct Kind {
  std::string model;
  torch::Dtype dtype;
  double tolerance;
  double gradient_tolerance;
};

std::ostream& operator<<(std::ostream& stream, const Kind& kind) {
  return stream << kind.model << (kind.dtype == torch::kFloat64 ? "_double" : "_float");
}

std::vector<Kind> kinds() {
  std::vector<Kind> list;
  for (const std::string model : {"level", "cascade", "special", "predicts_data", "carried"}) {
    list.push_back({model, torch::kFloat64, 1e-13, 1e-11});
    list.push_back({model, torch::kFloat32, 1e-5, 5e-4});
  }
  return list;
}

// Scenes that differ in all that may differ: sources, cameras, latents, flow times, branches and masks.
class DitPassesOf : public testing::TestWithParam<Kind> {
 protected:
  DitPassesOf() {
    DitOptions options = GetParam().model == "cascade" ? small_cascade_options() : small_dit_options();
    if (GetParam().model == "special") {
      options.num_special_tokens = 2;
      options.in_channels = 48;
    }
    if (GetParam().model == "predicts_data") options.prediction = FlowPrediction::kData;
    if (GetParam().model == "carried") {
      options.warped_sources = 2;
      options.carried_error = 0.2;
    }
    const bool in_double = GetParam().dtype == torch::kFloat64;
    model_ = random_dit(options);
    if (in_double) model_ = test::in_double(*model_);
    const std::vector<double> times{0.3, 0.9, 0.3, 0.05};
    for (int64_t i = 0; i < 4; ++i) {
      auto scene = random_dit_scene(options, {3, 1 + i % 3, 42, 28}, static_cast<uint64_t>(10 + i));
      if (in_double) scene = test::in_double(scene);
      if (i == 2) {
        scene.inputs.view_mask = torch::ones({3, 3}, torch::kBool);
        scene.inputs.view_mask[0][2] = scene.inputs.view_mask[2][0] = false;
      }
      FlowMatchingScene drawn;
      drawn.inputs = scene.inputs;
      drawn.draw.clean = scene.noisy;
      drawn.draw.noise = torch::randn_like(scene.noisy);
      drawn.draw.time = times[static_cast<size_t>(i)];
      drawn.draw.branch = i == 1 ? DitBranch::kUnconditional : DitBranch::kConditional;
      scenes_.push_back(drawn);
    }
  }

  torch::Tensor noisy(const FlowMatchingScene& scene) const {
    return interpolate(scene.draw.clean, scene.draw.noise, scene.draw.time);
  }

  std::vector<torch::Tensor> gradients(const std::function<torch::Tensor()>& loss) const {
    model_->zero_grad();
    loss().backward();
    std::vector<torch::Tensor> result;
    for (const auto& parameter : model_->parameters()) {
      result.push_back(parameter.grad().defined() ? parameter.grad().clone() : torch::Tensor());
    }
    return result;
  }

  std::shared_ptr<DitDh> model_;
  std::vector<FlowMatchingScene> scenes_;
};

TEST_P(DitPassesOf, VelocitiesAreThoseOfEachSceneAlone) {
  const torch::NoGradGuard no_grad;
  std::vector<DitScene> prepared;
  std::vector<DitTimeRow> times;
  std::vector<torch::Tensor> states, alone;
  for (const auto& scene : scenes_) {
    prepared.push_back(model_->prepare_scene(scene.inputs));
    times.push_back(model_->time_rows({scene.draw.time}).front());
    states.push_back(noisy(scene));
    alone.push_back(model_->velocity(prepared.back(), states.back(), times.back(), scene.draw.branch));
  }
  DitPasses passes;
  for (size_t i = 0; i < scenes_.size(); ++i) {
    passes.push_back({&prepared[i], &times[i], scenes_[i].draw.branch});
  }
  const auto together = model_->velocity(passes, torch::cat(states));
  EXPECT_LT(relative_difference(together, torch::cat(alone)), GetParam().tolerance);
  // Which a mix-up of the scenes would not survive.
  EXPECT_GT(relative_difference(together, torch::cat(alone).flip(0)), 0.1);
}

TEST_P(DitPassesOf, LossesAndGradientsAreThoseOfEachSceneAlone) {
  const auto one_by_one = [&] {
    torch::Tensor sum = torch::zeros({}, GetParam().dtype);
    for (const auto& scene : scenes_) sum = sum + flow_matching_errors(*model_, scene.inputs, scene.draw).all;
    return sum;
  };
  const auto together = [&] {
    torch::Tensor sum = torch::zeros({}, GetParam().dtype);
    for (const auto& errors : flow_matching_errors(*model_, scenes_)) sum = sum + errors.all;
    return sum;
  };
  const auto errors = flow_matching_errors(*model_, scenes_);
  for (size_t i = 0; i < scenes_.size(); ++i) {
    const auto alone = flow_matching_errors(*model_, scenes_[i].inputs, scenes_[i].draw);
    EXPECT_LT(relative_difference(errors[i].all, alone.all), GetParam().tolerance);
    EXPECT_LT(relative_difference(errors[i].source, alone.source), GetParam().tolerance);
    // A scene of sources alone has no error of target views: NaN, the mean of nothing.
    if (scenes_[i].inputs.views.num_targets() > 0) {
      EXPECT_LT(relative_difference(errors[i].target, alone.target), GetParam().tolerance);
    }
  }
  const auto expected = gradients(one_by_one);
  const auto kept = gradients(together);
  model_->set_activation_storage(ActivationStorage::kRecompute);
  const auto recomputed = gradients(together);
  for (size_t i = 0; i < expected.size(); ++i) {
    ASSERT_EQ(expected[i].defined(), kept[i].defined());
    ASSERT_EQ(expected[i].defined(), recomputed[i].defined());
    if (!expected[i].defined()) continue;
    EXPECT_LT(relative_difference(kept[i], expected[i]), GetParam().gradient_tolerance);
    EXPECT_LT(relative_difference(recomputed[i], expected[i]), GetParam().gradient_tolerance);
  }
}

TEST_P(DitPassesOf, AttentionIsTappedSceneByScene) {
  std::vector<std::vector<AttentionTap>> taps(scenes_.size(), {{1, {}, {}}, {2, {}, {}}});
  auto tapped = scenes_;
  for (size_t i = 0; i < tapped.size(); ++i) {
    if (i != 1) tapped[i].draw.taps = &taps[i];
  }
  flow_matching_errors(*model_, tapped);
  EXPECT_FALSE(taps[1][0].query.defined());
  for (const size_t i : {size_t{0}, size_t{3}}) {
    std::vector<AttentionTap> alone{{1, {}, {}}, {2, {}, {}}};
    auto draw = scenes_[i].draw;
    draw.taps = &alone;
    flow_matching_errors(*model_, scenes_[i].inputs, draw);
    for (size_t block = 0; block < alone.size(); ++block) {
      EXPECT_LT(relative_difference(taps[i][block].query, alone[block].query), GetParam().tolerance);
      EXPECT_LT(relative_difference(taps[i][block].key, alone[block].key), GetParam().tolerance);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Models, DitPassesOf, testing::ValuesIn(kinds()), testing::PrintToStringParamName());

TEST(DitPasses, RefusesScenesOfAnotherSize) {
  const auto model = random_dit(small_dit_options());
  const auto one = random_dit_scene(model->options(), {3, 1, 42, 28});
  const auto other = random_dit_scene(model->options(), {4, 1, 42, 28});
  const auto a = model->prepare_scene(one.inputs), b = model->prepare_scene(other.inputs);
  const auto time = model->time_rows({0.5}).front();
  EXPECT_EQ(
      test::error_of([&] {
        model->velocity({{&a, &time, {}}, {&b, &time, {}}}, torch::cat({one.noisy, other.noisy}));
      }),
      "scenes of one evaluation: expected 3 views of 3 x 2 tokens in each, found one with 4 views of 3 x 2; "
      "evaluate scenes of one size together.");
  EXPECT_EQ(test::error_of([&] { model->velocity(DitPasses{}, one.noisy); }),
            "diffusion model: expected at least one scene to evaluate, found none; give scenes.");
}

}  // namespace
}  // namespace gld
