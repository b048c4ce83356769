#include "gld/latents/latent_divergence.h"

#include <cmath>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

LatentStatistics two_channels() {
  LatentStatistics statistics;
  statistics.mean = torch::tensor({1.0F, -2.0F});
  statistics.variance = torch::tensor({4.0F, 0.25F});
  statistics.epsilon = 0;
  return statistics;
}

TEST(LatentDivergence, IsThatOfNormalDistributions) {
  const LatentStatistics known = two_channels();
  EXPECT_NEAR(latent_divergence(known, known), 0, 1e-7);  // float32
  LatentStatistics scene = known;
  scene.mean = torch::tensor({3.0F, -2.0F});        // one deviation off
  scene.variance = torch::tensor({4.0F, 0.0625F});  // a quarter of the variance
  EXPECT_NEAR(latent_divergence(scene, known), 0.5 * (0.5 + 0.5 * (0.25 - 1 - std::log(0.25))), 1e-6);
}

// The tokens are (1, 3), (5, 3): the first channel has mean 3 and variance 4, the second 3 and none.
TEST(LatentDivergence, OfFeaturesIsThatOfTheirMoments) {
  LatentStatistics known = two_channels();
  known.mean = torch::tensor({3.0F, 3.0F});
  const auto features = torch::tensor({{{1.0F, 3.0F}, {5.0F, 3.0F}}});
  // A channel without variance counts as 1e-6 of it.
  EXPECT_NEAR(latent_divergence(features, known), 0.25 * (1e-6 - 1 - std::log(1e-6)), 1e-6);
}

}  // namespace
}  // namespace gld
