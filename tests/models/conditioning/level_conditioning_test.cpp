#include "models/conditioning/level_conditioning.h"

#include "models/conditioning/decoder_inputs.h"
#include "tests/support/error_of.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

torch::Tensor random(const std::vector<int64_t>& shape, uint64_t seed) {
  return torch::randn(shape, at::detail::createCPUGenerator(seed));
}

LevelStatistics statistics_of(double mean, double variance, int64_t channels) {
  LevelStatistics statistics;
  statistics.patches.mean = torch::full({channels}, mean);
  statistics.patches.variance = torch::full({channels}, variance);
  statistics.patches.epsilon = 0;
  return statistics;
}

// Two source views and a target of 2x3 patches, a leading token, 4 channels, 14 pixels a patch.
struct Conditions {
  Views views;
  SourceConditioning sources;
  DitOptions options;
  LevelStatistics statistics = statistics_of(1, 4, 4);

  Conditions() {
    Camera camera;
    camera.width = 42;
    camera.height = 28;
    views.cameras = {camera, camera, camera};
    views.num_sources = 2;
    sources.grid = {2, 2, 3};
    sources.levels = {random({2, 7, 4}, 1), random({2, 7, 4}, 2)};
    sources.warped.agreement = random({1, 3, 28, 42}, 3);
    sources.warped.levels = {random({1, 6, 4}, 4), random({1, 6, 4}, 5)};
    options.in_channels = 4;
    options.camera_patch_size = 14;
  }
};

TEST(LevelConditioning, ShowsTheSourceLevelAndThePhotographsNormalised) {
  Conditions given;
  given.options.warped_sources = 2;
  const auto inputs =
      condition_on_source_level({1, given.options, given.statistics}, given.views, given.sources);
  EXPECT_TRUE(inputs.source_features.equal((given.sources.levels[1].slice(1, 1) - 1) / 2));
  EXPECT_TRUE(inputs.warped_features.equal((given.sources.warped.levels[1] - 1) / 2));
  // It takes the first two of three: as many as it has room for.
  EXPECT_TRUE(inputs.warp_agreement.equal(given.sources.warped.agreement.slice(1, 0, 2)));
  EXPECT_FALSE(inputs.deeper_level.defined());

  given.sources.warped = {};
  const auto nothing =
      condition_on_source_level({1, given.options, given.statistics}, given.views, given.sources);
  EXPECT_EQ(nothing.warp_agreement.sizes(), (std::vector<int64_t>{1, 2, 28, 42}));
  EXPECT_EQ(nothing.warped_features.abs().max().item<double>(), 0);
  EXPECT_TRUE(nothing.source_features.equal(inputs.source_features));

  given.options.warped_sources = 0;
  const auto without =
      condition_on_source_level({0, given.options, given.statistics}, given.views, given.sources);
  EXPECT_FALSE(without.warp_agreement.defined());
  EXPECT_FALSE(without.warped_features.defined());
  EXPECT_TRUE(without.source_features.equal((given.sources.levels[0].slice(1, 1) - 1) / 2));
}

// A standard normal level stays one, however strong the noise.
TEST(LevelConditioning, NoiseOnTheDeeperLevelKeepsItsVariance) {
  const auto level = random({4, 500, 50}, 1), noise = random({4, 500, 50}, 2);
  EXPECT_TRUE(noisy_deeper_level(level, noise, 0).equal(level));
  for (const double sigma : {0.3, 2.0}) {
    const auto noisy = noisy_deeper_level(level, noise, sigma);
    // The variance of 100000 squares' mean is sqrt(2 / 100000) = 0.0045; four of these are allowed.
    EXPECT_NEAR(noisy.square().mean().item<double>(), 1, 0.018);
    // Its correlation with what it was is 1 / sqrt(1 + sigma^2), whose deviation is below 1 / sqrt(100000) = 0.0032.
    EXPECT_NEAR((noisy * level).mean().item<double>(), 1 / std::sqrt(1 + sigma * sigma), 0.018);
  }
}

TEST(DecoderInputs, LevelsThatAreNotThereAreZeros) {
  const auto a = random({2, 6, 4}, 1), b = random({2, 6, 4}, 2);
  EXPECT_TRUE(image_features({a, b}, {0, 1}).equal(torch::cat({a, b}, 2)));
  EXPECT_TRUE(image_features({a, b}, {1}).equal(b));
  EXPECT_TRUE(image_features({{}, b, {}}, {0, 1}).equal(torch::cat({torch::zeros_like(b), b}, 2)));
  EXPECT_EQ(test::error_of([&] {
              image_features({{}, {}}, {0, 1});
            }),
            "RGB decoding: expected a level that was generated or propagated, found none; generate one.");
}

}  // namespace
}  // namespace gld
