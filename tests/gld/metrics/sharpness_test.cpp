#include "gld/metrics/sharpness.h"

#include "gld/metrics/metric_list.h"
#include "tests/support/error_of.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

torch::Tensor random_images(int64_t views) {
  return torch::rand({views, 3, 20, 30}, at::detail::createCPUGenerator(2));
}

torch::Tensor blurred(const torch::Tensor& images) {
  return torch::avg_pool2d(images, /*kernel_size=*/3, /*stride=*/1, /*padding=*/1);
}

TEST(GradientEnergy, IsTheMeanSquaredStepAlongRowsPlusColumns) {
  // Columns rise by 0.25, rows by 0.125; the last column lies above 1 and counts as 1.
  const auto columns = torch::tensor({0.0, 0.25, 0.5}).view({1, 1, 1, 3});
  const auto rows = torch::tensor({0.0, 0.125}).view({1, 1, 2, 1});
  EXPECT_NEAR(gradient_energy(columns + rows)[0].item<double>(), 0.0625 + 0.015625, 1e-9);
  const auto clipped = torch::tensor({0.5, 3.0}).view({1, 1, 1, 2}).expand({1, 1, 2, 2});
  EXPECT_NEAR(gradient_energy(clipped)[0].item<double>(), 0.25, 1e-12);
}

TEST(Sharpness, IsOneForTheSameImageLessForABlurredAndMoreForANoisyOne) {
  const auto image = blurred(random_images(2));
  EXPECT_LT((sharpness(image, image) - 1).abs().max().item<double>(), 1e-12);
  EXPECT_LT(sharpness(image, blurred(image)).max().item<double>(), 0.9);
  EXPECT_GT(sharpness(image, image + 0.5 * (random_images(2) - 0.5)).min().item<double>(), 1.1);
  // Half the contrast is a quarter of the energy.
  EXPECT_NEAR(sharpness(image, image * 0.5)[0].item<double>(), 0.25, 1e-6);
}

TEST(Sharpness, OfAnImageWithoutEdgesIsAbsent) {
  const auto flat = torch::full({1, 3, 8, 8}, 0.5);
  EXPECT_TRUE(
      std::isnan(sharpness(flat, random_images(1).narrow(2, 0, 8).narrow(3, 0, 8))[0].item<double>()));
  EXPECT_EQ(measure_images(metric_named("sharpness"), flat, flat).absent, "the true images have no edges");
  EXPECT_EQ(
      test::error_of([] {
        gradient_energy(torch::zeros({1, 3, 1, 5}));
      }),
      "sharpness: expected images (views, channels, height, width) of at least 2x2 pixels, found [1, 3, "
      "1, 5]; compare larger images.");
}

}  // namespace
}  // namespace gld
