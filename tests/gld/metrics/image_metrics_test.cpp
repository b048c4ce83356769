#include "gld/metrics/image_metrics.h"

#include "gld/metrics/metric_list.h"
#include "tests/support/error_of.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

torch::Tensor random_images(int64_t views, int64_t height, int64_t width) {
  return torch::rand({views, 3, height, width}, at::detail::createCPUGenerator(1));
}

TEST(Psnr, FollowsTheMeanSquaredDifferenceOfClampedImages) {
  const auto image = torch::full({2, 3, 4, 5}, 0.5);
  auto prediction = image + 0.1;
  prediction[1] = 0.5 + 0.001;
  const auto value = psnr(image, prediction);
  EXPECT_EQ(value.scalar_type(), torch::kFloat64);
  EXPECT_NEAR(value[0].item<double>(), 20, 1e-5);
  EXPECT_NEAR(value[1].item<double>(), 60, 1e-3);
  // Beyond [0, 1] nothing counts.
  const auto white = torch::ones({1, 3, 2, 2});
  EXPECT_TRUE(std::isinf(psnr(white, white * 5)[0].item<double>()));
}

TEST(Ssim, IsOneForEqualImagesAndNegativeForInvertedOnes) {
  const auto image = random_images(2, 24, 31);
  EXPECT_LT((ssim(image, image) - 1).abs().max().item<double>(), 1e-12);
  EXPECT_LT(ssim(image, 1 - image).max().item<double>(), -0.9);
  const auto flat = torch::full({1, 1, 11, 11}, 0.25);
  // Constant images differ in luminance only: (2 a b + C1) / (a^2 + b^2 + C1).
  EXPECT_NEAR(ssim(flat, flat * 2)[0].item<double>(), (2 * 0.125 + 1e-4) / (0.0625 + 0.25 + 1e-4), 1e-9);
}

TEST(ImageMetrics, BlackAndWhiteImagesGiveFiniteSimilarity) {
  const auto black = torch::zeros({1, 3, 16, 16}), white = torch::ones({1, 3, 16, 16});
  EXPECT_NEAR(psnr(black, white)[0].item<double>(), 0, 1e-12);
  EXPECT_NEAR(ssim(black, white)[0].item<double>(), 1e-4 / (1 + 1e-4), 1e-9);
  EXPECT_NEAR(ssim(black, black)[0].item<double>(), 1, 1e-12);
}

TEST(ImageMetrics, SsimOfImagesSmallerThanItsWindowIsAbsent) {
  const auto small = random_images(1, 10, 20);
  EXPECT_EQ(measure_images(metric_named("ssim"), small, small).absent,
            "the images are smaller than its window of 11 pixels");
  const auto image = random_images(2, 11, 20);
  EXPECT_NEAR(measure_images(metric_named("ssim"), image, image).mean(), 1, 1e-12);
}

TEST(ImageMetrics, RefuseWhatDoesNotFitInOneSentence) {
  EXPECT_EQ(test::error_of([] { psnr(random_images(1, 4, 4), random_images(1, 4, 5)); }),
            "PSNR: expected two image batches (views, channels, height, width) of one shape, found [1, 3, 4, "
            "4] and [1, 3, 4, 5]; compare images of the same size.");
  EXPECT_EQ(test::error_of([] { ssim(random_images(1, 20, 10), random_images(1, 20, 10)); }),
            "SSIM: expected images of at least 11x11 pixels, found 10x20; compare larger images.");
}

}  // namespace
}  // namespace gld
