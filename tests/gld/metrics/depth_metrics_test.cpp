#include "gld/metrics/depth_metrics.h"

#include "tests/support/error_of.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

TEST(DepthErrors, CountOnlyPixelsWithAValidTruth) {
  const auto truth = torch::tensor({2.0f, 4.0f, 0.0f, -1.0f, kInfinity, kNaN}).view({1, 2, 3});
  const auto prediction = torch::tensor({3.0f, 4.4f, 9.0f, 9.0f, 9.0f, 9.0f}).view({1, 2, 3});
  const auto errors = depth_errors(truth, prediction);
  EXPECT_EQ(errors.valid_pixels[0].item<int64_t>(), 2);
  EXPECT_NEAR(errors.abs_rel[0].item<double>(), (0.5 + 0.1) / 2, 1e-7);
  EXPECT_NEAR(errors.rmse[0].item<double>(), std::sqrt((1 + 0.16) / 2), 1e-6);
  EXPECT_NEAR(errors.delta1[0].item<double>(), 0.5, 1e-12);  // 3/2 is too far, 4.4/4 is not
}

TEST(DepthErrors, AZeroPredictionIsWrongAndFinite) {
  const auto errors = depth_errors(torch::ones({1, 1, 2}), torch::tensor({0.0f, 1.0f}).view({1, 1, 2}));
  EXPECT_EQ(errors.delta1[0].item<double>(), 0.5);
  EXPECT_EQ(errors.abs_rel[0].item<double>(), 0.5);
}

TEST(DepthErrors, AViewWithoutValidPixelsHasNoError) {
  auto truth = torch::ones({2, 2, 2});
  truth[1] = 0;
  const auto errors = depth_errors(truth, torch::ones({2, 2, 2}));
  EXPECT_EQ(errors.abs_rel[0].item<double>(), 0);
  EXPECT_EQ(errors.valid_pixels[1].item<int64_t>(), 0);
  EXPECT_TRUE(std::isnan(errors.abs_rel[1].item<double>()));
  EXPECT_TRUE(std::isnan(errors.rmse[1].item<double>()));
  EXPECT_TRUE(std::isnan(errors.delta1[1].item<double>()));
}

TEST(DepthScale, RecoversTheFactorOfAWholeScene) {
  const auto truth = torch::rand({3, 8, 9}) + 1;
  EXPECT_NEAR(median_depth_scale(truth, truth / 2.5), 2.5, 1e-5);
  EXPECT_NEAR(least_squares_depth_scale(truth, truth / 2.5), 2.5, 1e-5);
}

TEST(DepthScale, TheMedianIgnoresOutliersAndInvalidPixels) {
  const auto truth = torch::tensor({2.0f, 2.0f, 2.0f, 0.0f, 2.0f}).view({1, 1, 5});
  const auto prediction = torch::tensor({1.0f, 1.0f, 100.0f, 1.0f, 0.0f}).view({1, 1, 5});
  EXPECT_NEAR(median_depth_scale(truth, prediction), 2, 1e-12);
  EXPECT_NEAR(least_squares_depth_scale(truth, prediction), (2 + 2 + 200) / 10002.0, 1e-9);
}

TEST(DepthScale, StaysFiniteForExtremePredictions) {
  const auto truth = torch::ones({1, 1, 2});
  EXPECT_NEAR(least_squares_depth_scale(truth, torch::full({1, 1, 2}, 1e38)), 1e-38, 1e-43);
  EXPECT_NEAR(least_squares_depth_scale(truth, torch::full({1, 1, 2}, 1e-35)) / 1e35, 1, 1e-5);
}

TEST(DepthScale, RefusesScenesWithoutACommonPixel) {
  EXPECT_EQ(test::error_of([] {
              median_depth_scale(torch::zeros({1, 1, 2}), torch::ones({1, 1, 2}));
            }),
            "depth alignment: expected pixels with a positive finite depth in truth and prediction, found "
            "none; check "
            "the depth maps and their validity masks.");
  EXPECT_EQ(test::error_of([] {
              depth_errors(torch::zeros({1, 1, 2}), torch::ones({1, 1, 3}));
            }),
            "depth metrics: expected two batches of depth maps (views, height, width) of one shape, found "
            "[1, 1, 2] "
            "and [1, 1, 3]; resize the prediction to the truth.");
}

}  // namespace
}  // namespace gld
