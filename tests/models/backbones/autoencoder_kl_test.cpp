#include "models/backbones/autoencoder_kl.h"

#include <ATen/CPUGeneratorImpl.h>
#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

AutoencoderKlOptions small_autoencoder() {
  AutoencoderKlOptions options;
  options.block_out_channels = {8, 8};
  options.layers_per_block = 1;
  options.norm_groups = 4;
  return options;
}

AutoencoderKl with_posterior(Posterior posterior, int64_t seed) {
  AutoencoderKlOptions options = small_autoencoder();
  options.posterior = posterior;
  options.posterior_seed = seed;
  AutoencoderKl model(options, {});
  model.initialise(at::detail::createCPUGenerator(4));
  return model;
}

// A sample is mean + exp(logarithm of the variance / 2) standard normal numbers, of the picture and the seed alone.
TEST(AutoencoderKlPosterior, IsSampledAroundItsMean) {
  const torch::NoGradGuard no_grad;
  const auto images = torch::rand({2, 3, 32, 32}, at::detail::createCPUGenerator(2));
  const auto mean = with_posterior(Posterior::kMean, 0).encode(images, 0).front();
  const auto model = with_posterior(Posterior::kSample, 7);
  const auto sample = model.encode(images, 0).front();
  EXPECT_TRUE(sample.equal(with_posterior(Posterior::kSample, 7).encode(images, 0).front()));
  EXPECT_FALSE(sample.equal(with_posterior(Posterior::kSample, 8).encode(images, 0).front()));
  // Another picture beside it changes nothing.
  EXPECT_TRUE(sample.narrow(0, 1, 1).equal(model.encode(images.narrow(0, 1, 1), 0).front()));

  const auto moments = model.moments(images).chunk(2, 1);
  const auto deviation =
      torch::exp(moments[1] / 2).mean().item<double>() * small_autoencoder().scaling_factor;
  const auto noise = (sample - mean).flatten();
  EXPECT_NEAR(noise.mean().item<double>() / deviation, 0, 0.1);
  EXPECT_NEAR(noise.std().item<double>() / deviation, 1, 0.1);
}

}  // namespace
}  // namespace gld
