// Norms over the range of numbers they may meet, against double.
#include "gld/tensors/weight_tensors.h"
#include "models/layers/layers.h"
#include "tests/support/data_folders.h"

#include <cmath>

#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr int64_t kChannels = 384;

std::shared_ptr<RmsNorm> rms_norm(double epsilon, torch::Dtype dtype) {
  auto norm = std::make_shared<RmsNorm>(kChannels, epsilon, ParameterPlacement{torch::kCPU, dtype});
  const torch::NoGradGuard no_grad;
  norm->weight.copy_(torch::linspace(0.5, 1.5, kChannels));
  return norm;
}

torch::Tensor unit_rows(int64_t rows) {
  torch::manual_seed(5);
  return torch::randn({rows, kChannels}, torch::kFloat64);
}

// In double, every row scaled to magnitude 1 first.
torch::Tensor exact_rms_norm(const torch::Tensor& x, double epsilon, const torch::Tensor& weight) {
  const auto wide = x.to(torch::kFloat64);
  const auto largest = wide.abs().amax({-1}, true).clamp_min(1e-300);
  const auto unit = wide / largest;
  const auto root = (unit.square().mean(-1, true) + epsilon / largest / largest).sqrt();
  return unit / root * weight.to(torch::kFloat64);
}

double relative_error(const torch::Tensor& value, const torch::Tensor& exact) {
  const auto difference = (value.to(torch::kFloat64) - exact).abs().amax({-1});
  return (difference / exact.abs().amax({-1}).clamp_min(1e-300)).max().item<double>();
}

TEST(NormExtremes, ZeroAndConstantRows) {
  const auto norm = rms_norm(1e-6, torch::kFloat32);
  EXPECT_EQ(norm->forward(torch::zeros({2, kChannels})).abs().max().item<double>(), 0);
  auto mixed = torch::zeros({2, kChannels});
  mixed[1].fill_(1e25);
  const auto y = norm->forward(mixed);
  EXPECT_EQ(y[0].abs().max().item<double>(), 0);
  EXPECT_LT(relative_error(y[1], norm->weight.detach().to(torch::kFloat64)), 1e-6);
}

// Gradients are those of double also where rows have to be scaled.
TEST(NormExtremes, GradientsAreThoseOfDouble) {
  for (const double magnitude : {1e-30, 1e-3, 1.0, 1e12, 1e25}) {
    const auto start = (unit_rows(3) * magnitude).to(torch::kFloat32);
    const auto weights = unit_rows(3);
    const auto gradient = [&](torch::Dtype dtype) {
      const auto norm = rms_norm(1e-6, dtype);
      auto x = start.to(dtype).detach().clone().set_requires_grad(true);
      (norm->forward(x) * weights.to(dtype)).sum().backward();
      return (x.grad() * magnitude).to(torch::kFloat64);
    };
    const auto single = gradient(torch::kFloat32), exact = gradient(torch::kFloat64);
    EXPECT_LT(relative_error(single, exact), 2e-5) << magnitude;
  }
}

TEST(NormExtremes, HalvesDoNotOverflow) {
  const auto norm = rms_norm(1e-6, torch::kFloat16);
  const auto x = (unit_rows(2) * 5000).to(torch::kFloat16);
  const auto y = norm->forward(x);
  EXPECT_EQ(y.scalar_type(), torch::kFloat16);
  EXPECT_LT(relative_error(y, exact_rms_norm(x, 1e-6, norm->weight)), 3e-3);
}

// Features as large and as uneven as the published statistics say: channel means up to 56, standard deviations 0.12 to
// 10.
TEST(NormExtremes, RealStatisticsLoseNoDigits) {
  for (const char* file : {"da3/normalization_stats_level0.pt", "da3/normalization_stats_level1.pt",
                           "vggt/normalization_stats_level0.pt", "vggt/normalization_stats_level1.pt"}) {
    const auto tensors = read_all(test::test_data() / "stats" / file);
    const auto mean = tensors.at("mean").flatten().to(torch::kFloat64);
    const auto deviation = (tensors.at("var").flatten().to(torch::kFloat64) + 1e-5).sqrt();
    const int64_t channels = mean.numel();
    torch::manual_seed(7);
    const auto features =
        (mean + deviation * torch::randn({64, channels}, torch::kFloat64)).to(torch::kFloat32);
    const auto wide = features.to(torch::kFloat64);

    RmsNorm rms(channels, 1e-6, {});
    LayerNorm layer(channels, 1e-6, {});
    const torch::NoGradGuard no_grad;
    rms.weight.fill_(1);
    layer.weight.fill_(1);
    layer.bias.zero_();
    EXPECT_LT(relative_error(rms.forward(features), wide * (wide.square().mean(-1, true) + 1e-6).rsqrt()),
              1e-6);
    const auto centred = wide - wide.mean(-1, true);
    EXPECT_LT(
        relative_error(layer.forward(features), centred * (centred.square().mean(-1, true) + 1e-6).rsqrt()),
        1e-6);
    // The latent and back, as sampling does.
    const auto mean32 = mean.to(torch::kFloat32), deviation32 = deviation.to(torch::kFloat32);
    const auto latent = (features - mean32) / deviation32;
    EXPECT_LT(((latent.to(torch::kFloat64) - (wide - mean) / deviation)).abs().max().item<double>(), 5e-5);
    EXPECT_LT(relative_error(latent * deviation32 + mean32, wide), 1e-6);
  }
}

}  // namespace
}  // namespace gld
