// What was carried into target views, and the prediction that begins at it.
#include "models/dit/dit_dh.h"
#include "tests/support/error_of.h"
#include "tests/support/small_dit.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::random_dit;
using test::random_dit_scene;
using test::relative_difference;
using test::small_dit_options;

TEST(FirstGuess, WhatWasCarriedBelongsToModelsThatTakeIt) {
  const auto plain = random_dit(small_dit_options());
  auto options = small_dit_options();
  options.warped_sources = 2;
  const auto model = random_dit(options);
  const auto scene = random_dit_scene(options, {3, 2, 28, 28});
  const auto refusal = [&](const DitDh& dit, const std::function<void(DitSceneInputs&)>& change) {
    auto inputs = scene.inputs;
    change(inputs);
    return test::error_of([&] { dit.prepare_scene(inputs); });
  };
  EXPECT_EQ(
      refusal(*plain, [](DitSceneInputs&) {}),
      "warp agreement: expected none, for a model with warped_sources: 0, found shape [1, 2, 28, 28]; check the "
      "model's configuration and the size of the images.");
  EXPECT_EQ(
      refusal(*model, [](DitSceneInputs& i) { i.warp_agreement = torch::Tensor(); }),
      "warp agreement: expected shape [1, 2, 28, 28], found nothing; check the model's configuration and the size "
      "of the images.");
  EXPECT_EQ(
      refusal(*model, [](DitSceneInputs& i) { i.warped_features = i.warped_features.narrow(1, 0, 2); }),
      "warped features: expected shape [1, 4, 24], found shape [1, 2, 24]; check the model's configuration and the "
      "size of the images.");
}

// So that training can go on from a model that takes nothing: the embedder of pictures begins at zero.
TEST(FirstGuess, PicturesThatAreCarriedCountForNothingBeforeTraining) {
  auto options = small_dit_options();
  options.warped_sources = 1;
  DitDh model(options, ParameterPlacement{});
  model.initialise(at::detail::createCPUGenerator(3));
  for (const auto& parameter : model.named_parameters()) {
    if (parameter.key().rfind("warp_embedder.", 0) != 0) continue;
    EXPECT_EQ(parameter.value().abs().max().item<float>(), 0) << parameter.key();
  }
}

// Before training the network says nothing, and what was carried is the first guess.
TEST(FirstGuess, WhatWasCarriedIsTheFirstGuess) {
  const torch::NoGradGuard no_grad;
  auto options = small_dit_options();
  options.warped_sources = 2;
  options.carried_error = 0.1;
  options.prediction = FlowPrediction::kData;
  DitDh model(options, ParameterPlacement{});
  model.initialise(at::detail::createCPUGenerator(3));
  auto scene = random_dit_scene(options, {3, 1, 28, 28});
  scene.inputs.warp_agreement.fill_(1);
  const auto data_at = [&](double time, DitBranch branch) {
    const auto velocity = model.velocity(model.prepare_scene(scene.inputs), scene.noisy,
                                         model.time_rows({time}).front(), branch);
    return scene.noisy - velocity / std::min(1 / time, options.largest_inverse_time);
  };
  const double believed = 1 / (1 + std::exp(-2.0));
  const auto at_noise = data_at(1, DitBranch::kConditional);
  EXPECT_LT((at_noise.narrow(0, 1, 2) - believed * scene.inputs.warped_features).abs().max().item<double>(),
            1e-5);
  EXPECT_LT(at_noise[0].abs().max().item<double>(), 1e-5);  // nothing is carried into a source view
  EXPECT_LT(data_at(1, DitBranch::kUnconditional).abs().max().item<double>(), 1e-5);
  // Where noise and the carried features are as uncertain, it is half as much: t / (1 - t) = sqrt(0.1).
  const double even = std::sqrt(0.1) / (1 + std::sqrt(0.1));
  EXPECT_LT(
      (data_at(even, DitBranch::kConditional).narrow(0, 1, 2) - 0.5 * believed * scene.inputs.warped_features)
          .abs()
          .max()
          .item<double>(),
      1e-5);
  // At the end the network alone decides.
  for (const auto prediction : {FlowPrediction::kVelocity, FlowPrediction::kData}) {
    options.prediction = prediction;
    const auto trained = random_dit(options);
    auto without = scene.inputs;
    without.warp_agreement = torch::zeros_like(without.warp_agreement);
    const auto velocity = trained->velocity(trained->prepare_scene(scene.inputs), scene.noisy,
                                            trained->time_rows({0.0}).front());
    EXPECT_TRUE(velocity.isfinite().all().item<bool>());
    // Only what the embedders make of it differs: with their part at zero nothing does.
    for (auto& parameter : trained->named_parameters()) {
      if (parameter.key().rfind("warp_embedder.", 0) == 0) parameter.value().zero_();
    }
    const auto row = trained->time_rows({0.0}).front();
    EXPECT_LT(relative_difference(trained->velocity(trained->prepare_scene(scene.inputs), scene.noisy, row),
                                  trained->velocity(trained->prepare_scene(without), scene.noisy, row)),
              1e-6);
  }
}

// Latents of variance 1, carried features and noise as the model takes them to be: before training its error is that of
// the best linear estimate, sigma^2, at every time, and never more than that of the mixture.
TEST(FirstGuess, AGuessToBeCorrectedIsTheBestLinearEstimate) {
  const torch::NoGradGuard no_grad;
  auto options = small_dit_options();
  options.warped_sources = 2;
  options.carried_error = 0.2;
  options.prediction = FlowPrediction::kData;
  auto scene = random_dit_scene(options, {9, 1, 56, 56});
  scene.inputs.warp_agreement.fill_(1);
  const double trust = 1 / (1 + std::exp(-2.0));  // of an untrained gate where all agree
  auto generator = at::detail::createCPUGenerator(5);
  const auto data = torch::empty_like(scene.noisy).normal_(0, 1, generator);
  const auto noise = torch::empty_like(data).normal_(0, 1, generator);
  const auto of_carried = torch::empty_like(scene.inputs.warped_features).normal_(0, 1, generator);
  scene.inputs.warped_features = data.narrow(0, 1, 8) + std::sqrt(options.carried_error / trust) * of_carried;
  const auto error_at = [&](double time, CarriedGuess guess) {
    options.carried_guess = guess;
    DitDh model(options, ParameterPlacement{});
    model.initialise(at::detail::createCPUGenerator(3));
    const auto noisy = (1 - time) * data + time * noise;
    const auto velocity =
        model.velocity(model.prepare_scene(scene.inputs), noisy, model.time_rows({time}).front());
    const double divided =
        guess == CarriedGuess::kMixed ? std::min(1 / time, options.largest_inverse_time) : 1 / time;
    return (noisy - velocity / divided - data).narrow(0, 1, 8).square().mean().item<double>();
  };
  for (const double time : {0.05, 0.3, 0.6, 0.9, 1.0}) {
    const double of_noisy = (1 - time) * (1 - time) / (time * time);
    const double best = 1 / (1 + trust / options.carried_error + of_noisy);
    const double error = error_at(time, CarriedGuess::kCorrected);
    EXPECT_NEAR(error, best, 0.05 * best) << time;
    EXPECT_LT(error, error_at(time, CarriedGuess::kMixed)) << time;
  }
}

// At the end of a flow too, which divides by no t: what the network predicts has a share of 1 there.
TEST(FirstGuess, AGuessToBeCorrectedHasAVelocityAtTheEnd) {
  const torch::NoGradGuard no_grad;
  auto options = small_dit_options();
  options.warped_sources = 2;
  options.carried_error = 0.1;
  options.prediction = FlowPrediction::kData;
  options.carried_guess = CarriedGuess::kCorrected;
  const auto model = random_dit(options);
  const auto scene = random_dit_scene(options, {3, 1, 28, 28});
  const auto prepared = model->prepare_scene(scene.inputs);
  const auto velocity_at = [&](double time) {
    return model->velocity(prepared, scene.noisy, model->time_rows({time}).front());
  };
  EXPECT_TRUE(velocity_at(0).isfinite().all().item<bool>());
  EXPECT_LT(relative_difference(velocity_at(1e-4), velocity_at(0)), 1e-2);
}

}  // namespace
}  // namespace gld
