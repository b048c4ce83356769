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
    const AverageInPlace average(flat, optimiser.average());
    EXPECT_NEAR(parameters.bias[0].item<float>(), 0.5F * trained, 1e-7);
  }
  EXPECT_EQ(parameters.bias[0].item<float>(), trained);
}

// d a + (1 - d) w, of the values behind each step: at 0.75 a half would not be taken for the other.
TEST(Optimiser, TheAverageForgetsByItsDecay) {
  Parameters parameters;
  FlatParameters flat({{"bias", parameters.bias}});
  OptimiserOptions options;
  options.ema_decay = 0.75;
  Optimiser optimiser(flat, options);
  double expected = 0;
  for (int step = 0; step < 3; ++step) {
    parameters.bias.grad().fill_(1.0F);
    optimiser.step(0.1, optimiser.gradient_norm());
    expected = 0.75 * expected + 0.25 * parameters.bias[0].item<float>();
    EXPECT_NEAR(flat.part(optimiser.average(), 0)[0].item<float>(), expected, 1e-7) << step;
  }
  EXPECT_LT(expected, -0.05);
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

TEST(Muon, OrthogonalisesAMatrix) {
  auto generator = at::detail::createCPUGenerator(4);
  for (const auto& [rows, columns] : std::vector<std::pair<int64_t, int64_t>>{{24, 60}, {60, 24}, {32, 32}}) {
    const auto matrix = torch::empty({rows, columns}).normal_(0, 3, generator);
    const auto [u, s, vh] = torch::linalg_svd(matrix, /*full_matrices=*/false);
    const auto values = std::get<1>(torch::linalg_svd(nearly_orthogonal(matrix), /*full_matrices=*/false));
    EXPECT_GT(values.min().item<double>(), 0.3) << rows << " x " << columns;
    EXPECT_LT(values.max().item<double>(), 1.3) << rows << " x " << columns;
    // The same singular directions: U^T X V is diagonal.
    const auto turned = torch::mm(torch::mm(u.t(), nearly_orthogonal(matrix)), vh.t());
    EXPECT_LT((turned - torch::diag(turned.diag())).abs().max().item<double>(), 1e-4);
  }
}

TEST(Muon, MovesBlockMatricesByItsRuleAndTheRestByAdamW) {
  auto generator = at::detail::createCPUGenerator(8);
  const std::vector<std::string> names = {"x_embedder.weight",
                                          "blocks.0.attn.qkv.weight",
                                          "blocks.0.adaLN_modulation.1.weight",
                                          "blocks.0.attn.qkv.bias",
                                          "decoder_layers.1.output.dense.weight",
                                          "encoder.mid_block.resnets.0.conv1.weight",
                                          "conv_in.weight"};
  const std::vector<bool> muons = {false, true, false, false, true, true, false};
  std::vector<NamedParameter> with_muon, with_adam;
  for (const std::string& name : names) {
    const bool vector = name.find("bias") != std::string::npos;
    const bool kernels = name.find("conv") != std::string::npos;
    const auto value = torch::empty(vector    ? std::vector<int64_t>{9}
                                    : kernels ? std::vector<int64_t>{12, 2, 3, 1}
                                              : std::vector<int64_t>{12, 7});
    value.normal_(0, 1, generator);
    with_muon.push_back({name, value.clone()});
    with_adam.push_back({name, value.clone()});
  }
  FlatParameters muon_parameters(with_muon), adam_parameters(with_adam);
  OptimiserOptions options;
  options.weight_decay = 0.1;
  options.clip_norm = 1.0;
  options.ema_decay = 0.9;
  Optimiser adam(adam_parameters, options);
  options.algorithm = OptimiserAlgorithm::kMuon;
  Optimiser muon(muon_parameters, options);
  std::vector<torch::Tensor> value, momentum, average;
  for (const auto& item : with_muon) {
    value.push_back(item.parameter.detach().clone());
    momentum.push_back(torch::zeros_like(value.back()));
    average.push_back(value.back().clone());
  }
  constexpr double kRate = 0.02;
  for (int step = 0; step < 3; ++step) {
    double squares = 0;
    for (size_t i = 0; i < names.size(); ++i) {
      with_muon[i].parameter.mutable_grad().normal_(0, 2, generator);
      with_adam[i].parameter.mutable_grad().copy_(with_muon[i].parameter.grad());
      squares += with_muon[i].parameter.grad().square().sum().item<double>();
    }
    const double clip = std::min(1.0, 1.0 / std::sqrt(squares));
    for (size_t i = 0; i < names.size(); ++i) {
      if (!muons[i]) continue;
      const auto gradient = clip * with_muon[i].parameter.grad();
      momentum[i] = 0.95 * momentum[i] + 0.05 * gradient;
      const auto ahead = 0.95 * momentum[i] + 0.05 * gradient;
      // A convolution's kernels are a matrix of a row an output channel.
      const auto direction = nearly_orthogonal(ahead.reshape({12, -1})).reshape(ahead.sizes());
      value[i] = (1 - kRate * 0.1) * value[i] - kRate * 0.2 * std::sqrt(12.0) * direction;
      average[i] = 0.9 * average[i] + 0.1 * value[i];
    }
    adam.step(kRate, adam.gradient_norm());
    muon.step(kRate, muon.gradient_norm());
  }
  for (size_t i = 0; i < names.size(); ++i) {
    EXPECT_EQ(Optimiser::is_block_matrix(with_muon[i]), muons[i]) << names[i];
    const auto& expected = muons[i] ? value[i] : with_adam[i].parameter.detach();
    const auto& expected_average = muons[i] ? average[i] : adam_parameters.part(adam.average(), i);
    EXPECT_LT((with_muon[i].parameter.detach() - expected).abs().max().item<double>(), 1e-4) << names[i];
    EXPECT_LT((muon_parameters.part(muon.average(), i) - expected_average).abs().max().item<double>(), 1e-4)
        << names[i];
  }
}

// One had them all while the others waited: LibTorch's threads are divided among workers.
TEST(Muon, WorkersShareItsMatricesAndChangeNoBit) {
  std::vector<torch::Tensor> values;
  for (const int64_t workers : {1, 2, 5}) {
    auto generator = at::detail::createCPUGenerator(8);
    std::vector<NamedParameter> parameters;
    for (const auto& [rows, columns] :
         std::vector<std::pair<int64_t, int64_t>>{{40, 16}, {16, 16}, {24, 48}}) {
      const auto value = torch::empty({rows, columns}).normal_(0, 1, generator);
      parameters.push_back({"blocks." + std::to_string(rows) + ".weight", value});
    }
    FlatParameters flat(parameters);
    OptimiserOptions options;
    options.algorithm = OptimiserAlgorithm::kMuon;
    Optimiser optimiser(flat, options);
    flat.gradients().normal_(0, 1, generator);
    optimiser.step(0.02, optimiser.gradient_norm(), workers);
    values.push_back(torch::cat({flat.values(), optimiser.average()}).clone());
  }
  EXPECT_TRUE(torch::equal(values[1], values[0]));
  EXPECT_TRUE(torch::equal(values[2], values[0]));
}

TEST(LearningRate, FallsOnlyFromTheStartOfItsDecay) {
  LearningRateOptions options;
  options.schedule = LearningRateSchedule::kLinear;
  options.peak = 1.0;
  options.final = 0.0;
  options.warmup_steps = 10;
  options.decay_start_step = 100;
  EXPECT_NEAR(learning_rate(options, 4, 200), 0.5, 1e-12);
  EXPECT_EQ(learning_rate(options, 10, 200), 1.0);
  EXPECT_EQ(learning_rate(options, 99, 200), 1.0);
  EXPECT_NEAR(learning_rate(options, 150, 200), 0.5, 1e-12);
  EXPECT_NEAR(learning_rate(options, 200, 200), 0.0, 1e-12);
}

}  // namespace
}  // namespace gld
