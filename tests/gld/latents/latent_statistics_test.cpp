#include "gld/latents/latent_statistics.h"

#include "gld/latents/noise.h"
#include "gld/tensors/weight_tensors.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(LatentStatistics, ReadsThePublishedFilesAndLosesNoDigits) {
  for (const char* name : {"da3/normalization_stats_level0.pt", "da3/normalization_stats_level1.pt",
                           "vggt/normalization_stats_level1.pt", "vggt/special_stats_level0.pt"}) {
    const auto statistics = read_latent_statistics(test::test_data() / "stats" / name);
    const auto latent = views_noise(1, name, 2, {50, statistics.channels()});
    const auto features = statistics.denormalise(latent);
    // Half a unit in the last place of the largest features, divided by the smallest deviations.
    const auto deviation = (statistics.variance + 1e-5).sqrt();
    const auto rounding =
        (features.abs().amax(std::vector<int64_t>{0, 1}) / deviation).max().item<double>() * 1.2e-7;
    const auto back = statistics.normalise(features);
    EXPECT_LT((back - latent).abs().max().item<double>(), rounding + 1e-6) << name;
    const auto exact = (features.to(torch::kFloat64) - statistics.mean.to(torch::kFloat64)) /
                       (statistics.variance.to(torch::kFloat64) + 1e-5).sqrt();
    EXPECT_LT((back - exact).abs().max().item<double>(), 2e-6) << name;
  }
}

TEST(LatentStatistics, ComeFromFeatures) {
  const auto features = views_noise(2, "features", 3, {200, 4}) * torch::tensor({0.1, 1.0, 10.0, 3.0}) +
                        torch::tensor({56.0, 0.0, -3.0, 1.0});
  StreamingMoments moments(4);
  for (int64_t view = 0; view < 3; ++view) add_features(moments, features[view]);
  EXPECT_EQ(moments.count(), 600);
  const auto latent = statistics_of(moments, 0.0).normalise(features.to(torch::kFloat32));
  const auto flat = latent.to(torch::kFloat64).reshape({600, 4});
  EXPECT_LT(flat.mean(0).abs().max().item<double>(), 1e-4);
  EXPECT_LT(((flat * flat).mean(0) - 1).abs().max().item<double>(), 1e-4);
}

TEST(LatentStatistics, RefuseWhatTheyCannotBe) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "statistics.safetensors";
  const auto refusal = [&](const torch::Tensor& mean, const torch::Tensor& variance) {
    save_safetensors(file, {{"mean", mean}, {"var", variance}});
    return test::error_of([&] { read_latent_statistics(file); });
  };
  const std::string place = file.string();
  EXPECT_EQ(refusal(torch::zeros({2, 3}), torch::ones({3})),
            place +
                ": mean: expected shape (channels) or (1, channels, 1, 1), found shape [2, 3]; "
                "compute the statistics with gld stats.");
  EXPECT_EQ(
      refusal(torch::zeros({3}), torch::ones({4})),
      place + ": var: expected 3 channels, as the mean has, found 4; compute the statistics with gld stats.");
  EXPECT_EQ(refusal(torch::zeros({3}), -torch::ones({3})),
            place +
                ": var: expected variances of at least 0, found a negative one; "
                "compute the statistics with gld stats.");
  EXPECT_EQ(refusal(torch::full({3}, NAN), torch::ones({3})),
            place + ": mean: expected finite numbers, found others; compute the statistics with gld stats.");
  LatentStatistics statistics;
  statistics.mean = torch::zeros({3});
  statistics.variance = torch::ones({3});
  EXPECT_EQ(test::error_of([&] {
              statistics.normalise(torch::zeros({2, 4}));
            }),
            "latent statistics: expected 3 channels, found shape [2, 4]; "
            "use the statistics of this level and backbone.");
}

TEST(ViewsNoise, AViewsNoiseDependsOnItsIndexAlone) {
  const auto three = views_noise(7, "level 1", 3, {5, 4});
  const auto eight = views_noise(7, "level 1", 8, {5, 4});
  EXPECT_TRUE(torch::equal(three, eight.narrow(0, 0, 3)));
  EXPECT_FALSE(torch::equal(eight[0], eight[1]));
  EXPECT_FALSE(torch::equal(three, views_noise(8, "level 1", 3, {5, 4})));
  EXPECT_FALSE(torch::equal(three, views_noise(7, "level 0", 3, {5, 4})));
}

}  // namespace
}  // namespace gld
