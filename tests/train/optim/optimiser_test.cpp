#include "train/optim/optimiser.h"

#include "tests/support/error_of.h"
#include "train/optim/learning_rate.h"

#include <cmath>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Adam as its paper writes it, in double, one parameter at a time.
struct PlainAdam {
  double decoupled_decay, coupled_decay, first_beta, second_beta, epsilon, clip_norm, ema_decay;
  std::vector<double> value, first, second, average;
  int steps = 0;

  void step(const std::vector<double>& gradients, double rate) {
    double squares = 0.0;
    for (const double g : gradients) squares += g * g;
    const double scale = std::min(1.0, clip_norm / (std::sqrt(squares) + 1e-6));
    ++steps;
    for (size_t i = 0; i < value.size(); ++i) {
      const double g = gradients[i] * scale + coupled_decay * value[i];
      value[i] *= 1.0 - rate * decoupled_decay;
      first[i] = first_beta * first[i] + (1.0 - first_beta) * g;
      second[i] = second_beta * second[i] + (1.0 - second_beta) * g * g;
      const double m = first[i] / (1.0 - std::pow(first_beta, steps));
      const double v = second[i] / (1.0 - std::pow(second_beta, steps));
      value[i] -= rate * m / (std::sqrt(v) + epsilon);
      average[i] = ema_decay * average[i] + (1.0 - ema_decay) * value[i];
    }
  }
};

struct Parameters {
  torch::Tensor matrix = torch::zeros({5, 7});
  torch::Tensor bias = torch::zeros({3});
};

void compare_with_plain(OptimiserAlgorithm algorithm) {
  auto generator = at::detail::createCPUGenerator(11);
  Parameters parameters;
  parameters.matrix.normal_(0.0, 1.0, generator);
  parameters.bias.normal_(0.0, 1.0, generator);
  FlatParameters flat({{"matrix", parameters.matrix}, {"bias", parameters.bias}});
  OptimiserOptions options;
  options.algorithm = algorithm;
  options.weight_decay = 0.05;
  options.clip_norm = 2.0;
  options.ema_decay = 0.9;
  Optimiser optimiser(flat, options);

  const bool decoupled = algorithm == OptimiserAlgorithm::kAdamW;
  PlainAdam plain = {
      decoupled ? 0.05 : 0.0, decoupled ? 0.0 : 0.05, 0.9, 0.95, 1e-8, 2.0, 0.9, {}, {}, {}, {}};
  for (const auto& tensor : {parameters.matrix, parameters.bias}) {
    const auto values = tensor.flatten();
    for (int64_t i = 0; i < values.numel(); ++i) plain.value.push_back(values[i].item<float>());
  }
  plain.first.assign(plain.value.size(), 0.0);
  plain.second = plain.first;
  plain.average = plain.value;

  for (int step = 0; step < 20; ++step) {
    flat.zero_gradients();
    std::vector<double> gradients;
    for (auto* tensor : {&parameters.matrix, &parameters.bias}) {
      // Every third step is large enough to be clipped.
      tensor->grad().normal_(0.0, step % 3 == 0 ? 3.0 : 0.05, generator);
      const auto values = tensor->grad().flatten();
      for (int64_t i = 0; i < values.numel(); ++i) gradients.push_back(values[i].item<float>());
    }
    const double rate = 0.01 * (1 + step % 4);
    optimiser.step(rate, optimiser.gradient_norm());
    plain.step(gradients, rate);
  }
  const auto values = torch::cat({parameters.matrix.flatten(), parameters.bias.flatten()});
  const auto average =
      torch::cat({flat.part(optimiser.average(), 0).flatten(), flat.part(optimiser.average(), 1)});
  for (size_t i = 0; i < plain.value.size(); ++i) {
    EXPECT_NEAR(values[static_cast<int64_t>(i)].item<float>(), plain.value[i], 2e-6);
    EXPECT_NEAR(average[static_cast<int64_t>(i)].item<float>(), plain.average[i], 2e-6);
  }
}

TEST(Optimiser, AdamWEqualsAPlainDoubleImplementation) { compare_with_plain(OptimiserAlgorithm::kAdamW); }

TEST(Optimiser, AdamEqualsAPlainDoubleImplementation) { compare_with_plain(OptimiserAlgorithm::kAdam); }

TEST(Optimiser, GradientNormIsExactForLargeAndSmallParts) {
  Parameters parameters;
  FlatParameters flat({{"matrix", parameters.matrix}, {"bias", parameters.bias}});
  const Optimiser optimiser(flat, {});
  parameters.matrix.grad().fill_(3e15F);
  parameters.bias.grad().fill_(1.0F);
  EXPECT_NEAR(optimiser.gradient_norm() / (std::sqrt(35.0) * 3e15), 1.0, 1e-7);
  flat.zero_gradients();
  EXPECT_EQ(optimiser.gradient_norm(), 0.0);
}

TEST(Optimiser, AutogradWritesIntoTheFlatGradients) {
  Parameters parameters;
  FlatParameters flat({{"matrix", parameters.matrix}, {"bias", parameters.bias}});
  for (int pass = 0; pass < 2; ++pass) (parameters.matrix.sum() + 2.0 * parameters.bias.sum()).backward();
  EXPECT_EQ(flat.gradients().sum().item<float>(), 2.0F * (35.0F + 6.0F));
  flat.zero_gradients();
  EXPECT_EQ(parameters.bias.grad().abs().sum().item<float>(), 0.0F);
  EXPECT_EQ(flat.parameter_count(), 38);
}

TEST(Optimiser, TheAverageIsInPlaceOnlyForAWhile) {
  Parameters parameters;
  FlatParameters flat({{"bias", parameters.bias}});
  OptimiserOptions options;
  options.ema_decay = 0.5;
  Optimiser optimiser(flat, options);
  parameters.bias.grad().fill_(1.0F);
  optimiser.step(0.1, optimiser.gradient_norm());
  const float trained = parameters.bias[0].item<float>();
  {
    const AverageInPlace average(flat, optimiser);
    EXPECT_NEAR(parameters.bias[0].item<float>(), 0.5F * trained, 1e-7);
  }
  EXPECT_EQ(parameters.bias[0].item<float>(), trained);
}

TEST(Optimiser, RefusesAStateOfOtherSizes) {
  Parameters parameters;
  FlatParameters flat({{"bias", parameters.bias}});
  Optimiser optimiser(flat, {});
  auto state = optimiser.state();
  state["second_moment"] = torch::zeros({4});
  EXPECT_EQ(
      test::error_of([&] { optimiser.load_state(state, "run"); }),
      "run, tensor 'second_moment': expected shape [16], found shape [4]; resume with the objective and "
      "options that wrote the checkpoint.");
  state.erase("first_moment");
  EXPECT_EQ(test::error_of([&] { optimiser.load_state(state, "run"); }),
            "run: expected the optimiser's tensor 'first_moment', found none of that name; resume with the "
            "objective and options that wrote the checkpoint.");
}

TEST(LearningRate, WarmsUpAndFalls) {
  LearningRateOptions options;
  options.peak = 1.0;
  options.final = 0.1;
  options.warmup_steps = 4;
  EXPECT_DOUBLE_EQ(learning_rate(options, 0, 100), 0.25);
  EXPECT_DOUBLE_EQ(learning_rate(options, 3, 100), 1.0);
  EXPECT_DOUBLE_EQ(learning_rate(options, 99, 100), 1.0);
  options.schedule = LearningRateSchedule::kLinear;
  EXPECT_DOUBLE_EQ(learning_rate(options, 52, 100), 0.55);
  options.schedule = LearningRateSchedule::kCosine;
  EXPECT_NEAR(learning_rate(options, 52, 100), 0.55, 1e-12);
  EXPECT_NEAR(learning_rate(options, 28, 100), 0.1 + 0.9 * 0.5 * (1.0 + std::sqrt(0.5)), 1e-12);
  options.decay_end_step = 50;
  EXPECT_DOUBLE_EQ(learning_rate(options, 80, 100), 0.1);
}

}  // namespace
}  // namespace gld
