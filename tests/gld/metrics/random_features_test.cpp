#include "gld/metrics/random_features.h"

#include "gld/metrics/metric_list.h"
#include "tests/support/error_of.h"

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

torch::Tensor stripes(double shift) {
  const auto columns = torch::arange(32, torch::kFloat32) + shift;
  return (0.5 + 0.5 * torch::sin(columns * 0.8).sign()).expand({1, 3, 32, 32}).contiguous();
}

double distance(const torch::Tensor& a, const torch::Tensor& b) {
  return random_feature_distance(a, b)[0].item<double>();
}

TEST(RandomFeatures, AreAsFarFromEachOtherAsPicturesLook) {
  const auto truth = stripes(0);
  EXPECT_EQ(distance(truth, truth), 0);
  EXPECT_EQ(distance(truth, stripes(4)), distance(stripes(4), truth));
  const double dim = distance(truth, truth * 0.9), half = distance(truth, truth * 0.5 + 0.25);
  const double grey = distance(truth, torch::full_like(truth, 0.5));
  EXPECT_GT(dim, 0);
  EXPECT_LT(dim, half);
  EXPECT_LT(half, grey);
}

// What pixels call the best guess is not what looks most alike.
TEST(RandomFeatures, PreferASharpPictureSlightlyMovedToABlurredOne) {
  const auto truth = stripes(0);
  const auto blurred = torch::avg_pool2d(truth, {1, 9}, 1, {0, 4});
  EXPECT_LT(distance(truth, stripes(0.5)), 0.8 * distance(truth, blurred));
}

// Its weights are part of what the number means: another LibTorch must give the same.
TEST(RandomFeatures, AreTheSameEverywhere) { EXPECT_NEAR(distance(stripes(0), stripes(2)), 0.820223, 1e-5); }

TEST(RandomFeatures, AreAMapALayerOfUnitVectors) {
  const auto maps = random_feature_maps(torch::rand({2, 3, 19, 32}, at::detail::createCPUGenerator(1)));
  ASSERT_EQ(maps.size(), static_cast<size_t>(kRandomFeatureMaps));
  const std::vector<std::vector<int64_t>> shapes{
      {2, 32, 19, 32}, {2, 64, 10, 16}, {2, 128, 5, 8}, {2, 128, 3, 4}};
  for (size_t map = 0; map < maps.size(); ++map) {
    EXPECT_EQ(maps[map].sizes(), c10::IntArrayRef(shapes[map]));
    EXPECT_LT((maps[map].norm(2, 1) - 1).abs().max().item<double>(), 1e-5);
  }
  EXPECT_NE(test::error_of([] { random_feature_maps(torch::zeros({1, 3, 7, 30})); }), "");
}

TEST(RandomFeatures, AreAMetricOfImagesOrAbsent) {
  const Metric& metric = metric_named("random_features");
  EXPECT_TRUE(metric.of_images());
  EXPECT_EQ(measure_images(metric, stripes(0), stripes(1)).mean(), distance(stripes(0), stripes(1)));
  const auto small = torch::zeros({1, 3, 7, 30});
  EXPECT_EQ(measure_images(metric, small, small).absent, "random features take images of at least 8 pixels");
  EXPECT_EQ(
      test::error_of([&] { random_feature_distance(small, small); }),
      "random features: expected two batches of RGB images of one shape with sides of at least 8 pixels, found "
      "[1, 3, 7, 30] and [1, 3, 7, 30]; compare larger images.");
}

}  // namespace
}  // namespace gld
