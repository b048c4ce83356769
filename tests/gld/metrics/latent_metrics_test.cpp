#include "gld/metrics/metric_list.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(LatentMetrics, AreDistancesOverTheSpreadOfEachGeneratedLevel) {
  MetricInputs inputs;
  EXPECT_EQ(measure(metric_named("latent_error_level0"), inputs).absent, "there are no latents to compare");
  const auto truth = torch::randn({2, 8, 4, 4}, at::detail::createCPUGenerator(3));
  inputs.true_latents = {{0, truth}, {1, 2 * truth}};
  inputs.latents = {{0, truth}, {1, (2 * truth).mean({0, 2, 3}, true).expand({2, 8, 4, 4})}};
  EXPECT_EQ(measure(metric_named("latent_error_level0"), inputs).mean(), 0);
  EXPECT_NEAR(measure(metric_named("latent_error_level1"), inputs).mean(), 1, 1e-6);
  EXPECT_EQ(measure(metric_named("latent_error_level2"), inputs).absent, "level 2 is not predicted");
  inputs.latents[0] = truth + 0.1 * (truth - truth.mean({0, 2, 3}, true));
  EXPECT_NEAR(measure(metric_named("latent_error_level0"), inputs).mean(), 0.1, 1e-6);
  inputs.true_latents[0] = torch::ones({2, 8, 4, 4});
  inputs.latents[0] = torch::ones({2, 8, 4, 4});
  EXPECT_EQ(measure(metric_named("latent_error_level0"), inputs).absent, "its true latents are all the same");
}

}  // namespace
}  // namespace gld
