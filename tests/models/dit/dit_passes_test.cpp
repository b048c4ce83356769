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
};

std::ostream& operator<<(std::ostream& stream, const Kind& kind) {
  return stream << kind.model << (kind.dtype == torch::kFloat64 ? "_double" : "_float");
}

std::vector<Kind> kinds() {
  std::vector<Kind> list;
  for (const std::string model : {"level", "cascade", "special", "predicts_data", "carried", "corrected"}) {
    list.push_back({model, torch::kFloat64, 1e-13});
    list.push_back({model, torch::kFloat32, 1e-5});
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
    if (GetParam().model == "corrected") {
      options.warped_sources = 2;
      options.carried_error = 0.2;
      options.prediction = FlowPrediction::kData;
      options.carried_guess = CarriedGuess::kCorrected;
    }
    const bool is_double = GetParam().dtype == torch::kFloat64;
    model_ = random_dit(options);
    if (is_double) model_ = test::in_double(*model_);
    const std::vector<double> times{0.3, 0.9, 0.3, 0.05};
    for (int64_t i = 0; i < 4; ++i) {
      auto scene = random_dit_scene(options, {3, 1 + i % 3, 42, 28}, static_cast<uint64_t>(10 + i));
      if (is_double) scene = test::in_double(scene);
      FlowMatchingScene drawn;
      drawn.inputs = scene.inputs;
      drawn.draw.clean = scene.noisy;
      drawn.draw.noise = torch::randn_like(scene.noisy);
      drawn.draw.time = times[static_cast<size_t>(i)];
      drawn.draw.branch = i == 1 ? DitBranch::kUnconditional : DitBranch::kConditional;
      scenes_.push_back(drawn);
    }
  }

  static FlowMatchingScene in_double(FlowMatchingScene scene) {
    scene.inputs = test::in_double(test::DitTestScene{scene.inputs, scene.draw.clean}).inputs;
    scene.draw.clean = scene.draw.clean.to(torch::kFloat64);
    scene.draw.noise = scene.draw.noise.to(torch::kFloat64);
    return scene;
  }

  torch::Tensor noisy(const FlowMatchingScene& scene) const {
    return interpolate(scene.draw.clean, scene.draw.noise, scene.draw.time);
  }

  static torch::Tensor loss_one_by_one(const DitDh& model, const std::vector<FlowMatchingScene>& scenes) {
    torch::Tensor sum = torch::zeros({}, model.parameters().front().options());
    for (const auto& scene : scenes) sum = sum + flow_matching_errors(model, scene.inputs, scene.draw).all;
    return sum;
  }

  static torch::Tensor loss_together(const DitDh& model, const std::vector<FlowMatchingScene>& scenes) {
    torch::Tensor sum = torch::zeros({}, model.parameters().front().options());
    for (const auto& errors : flow_matching_errors(model, scenes)) sum = sum + errors.all;
    return sum;
  }

  static std::vector<torch::Tensor> gradients(DitDh& model, const torch::Tensor& loss) {
    model.zero_grad();
    loss.backward();
    std::vector<torch::Tensor> result;
    for (const auto& parameter : model.parameters()) {
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
  // A mix-up of the scenes would not survive this.
  EXPECT_GT(relative_difference(together, torch::cat(alone).flip(0)), 0.1);
}

TEST_P(DitPassesOf, LossesAndGradientsAreThoseOfEachSceneAlone) {
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
  const auto exact_model = test::in_double(*model_);
  std::vector<FlowMatchingScene> exact_scenes;
  for (const auto& scene : scenes_) exact_scenes.push_back(in_double(scene));
  const auto exact = gradients(*exact_model, loss_one_by_one(*exact_model, exact_scenes));
  // In double, sums in another order differ by 2^-29 of what float32 makes of them.
  const double share = GetParam().dtype == torch::kFloat64 ? 0x1p-29 : 1;
  const auto units = test::moved_by_units(exact, [&] {
    const auto moved = test::moved_by_a_unit(*exact_model);
    auto moved_scenes = exact_scenes;
    for (auto& scene : moved_scenes) {
      scene.inputs = test::moved_by_a_unit(scene.inputs);
      scene.draw.clean = test::moved_by_a_unit(scene.draw.clean);
      scene.draw.noise = test::moved_by_a_unit(scene.draw.noise);
    }
    return gradients(*moved, loss_one_by_one(*moved, moved_scenes));
  });
  const auto check = [&](const std::vector<torch::Tensor>& found, const char* way) {
    const auto parameters = model_->named_parameters();
    for (size_t i = 0; i < exact.size(); ++i) {
      ASSERT_EQ(exact[i].defined(), found[i].defined());
      if (!exact[i].defined()) continue;
      EXPECT_LE(test::largest_difference(found[i], exact[i]), share * test::rounding_bound(units[i]))
          << parameters[i].key() << ' ' << way;
    }
  };
  check(gradients(*model_, loss_one_by_one(*model_, scenes_)), "one by one");
  check(gradients(*model_, loss_together(*model_, scenes_)), "together");
  model_->set_activation_storage(ActivationStorage::kRecompute);
  check(gradients(*model_, loss_together(*model_, scenes_)), "recomputed");
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
