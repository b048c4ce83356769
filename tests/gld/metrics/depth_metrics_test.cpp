#include "gld/metrics/depth_metrics.h"

#include "gld/metrics/metric_list.h"
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
  EXPECT_NEAR(errors.sq_rel[0].item<double>(), (1.0 / 2 + 0.16 / 4) / 2, 1e-6);
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

TEST(DepthErrors, TheDeltasAreNested) {
  const auto truth = torch::ones({1, 1, 4});
  const auto prediction = torch::tensor({1.2f, 1.5f, 1.0f / 1.9f, 2.1f}).view({1, 1, 4});
  const auto errors = depth_errors(truth, prediction);
  EXPECT_EQ(errors.delta1[0].item<double>(), 0.25);  // 1.25
  EXPECT_EQ(errors.delta2[0].item<double>(), 0.5);   // 1.5625
  EXPECT_EQ(errors.delta3[0].item<double>(), 0.75);  // 1.953125
}

// Two views, twice and four times as near as the truth.
TEST(DepthMetrics, EachSaysWhatItWasScaledBy) {
  const auto truth = torch::rand({2, 6, 5}, torch::kFloat64) + 1;
  MetricInputs inputs;
  inputs.true_depth = truth;
  inputs.depth = truth.clone();
  inputs.depth[0] /= 2;
  inputs.depth[1] /= 4;
  const auto value = [&](const char* name) { return measure(metric_named(name), inputs); };
  EXPECT_NEAR(value("depth_abs_rel_median_scaled_per_view").mean(), 0, 1e-12);
  EXPECT_NEAR(value("depth_rmse_least_squares_scaled_per_view").mean(), 0, 1e-12);
  EXPECT_EQ(value("depth_delta3_median_scaled_per_view").mean(), 1);
  // One factor for both views cannot hide that they disagree.
  EXPECT_GT(value("depth_abs_rel_median_scaled").mean(), 0.2);
  EXPECT_EQ(value("depth_abs_rel_camera_scaled").absent, "the scale of the estimated cameras is unknown");
  inputs.camera_scale = 2;
  EXPECT_NEAR(value("depth_abs_rel_camera_scaled").per_view[0].item<double>(), 0, 1e-12);
  EXPECT_NEAR(value("depth_abs_rel_camera_scaled").per_view[1].item<double>(), 0.5, 1e-12);
  // A view that cannot be aligned has no error; it is not 0.
  inputs.depth[1] = -1;
  EXPECT_TRUE(std::isnan(value("depth_delta1_median_scaled_per_view").per_view[1].item<double>()));
  EXPECT_EQ(value("depth_delta1_median_scaled_per_view").mean(), 1);
}

TEST(DepthMetrics, PseudoDepthIsComparedAsItIs) {
  MetricInputs inputs;
  inputs.depth = torch::full({1, 2, 2}, 3.0);
  EXPECT_EQ(measure(metric_named("pseudo_depth_abs_rel"), inputs).absent,
            "there is no depth of the true pictures to compare with");
  inputs.pseudo_depth = torch::full({1, 2, 2}, 2.0);
  EXPECT_NEAR(measure(metric_named("pseudo_depth_abs_rel"), inputs).mean(), 0.5, 1e-12);
  EXPECT_NEAR(measure(metric_named("pseudo_depth_rmse"), inputs).mean(), 1, 1e-12);
  EXPECT_EQ(measure(metric_named("pseudo_depth_delta1"), inputs).mean(), 0);
  // Depth that photographs are part of does not count: it is the head that is measured.
  inputs.head_depth = torch::full({1, 2, 2}, 3.0);
  EXPECT_NEAR(measure(metric_named("pseudo_depth_abs_rel"), inputs).mean(), 0.5, 1e-12);
  inputs.head_depth = torch::full({1, 2, 2}, 2.0);
  EXPECT_EQ(measure(metric_named("pseudo_depth_abs_rel"), inputs).mean(), 0);
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
            "depth alignment: expected pixels with a positive finite depth in truth and prediction, "
            "found none; check the depth maps and their validity masks.");
  EXPECT_EQ(test::error_of([] {
              depth_errors(torch::zeros({1, 1, 2}), torch::ones({1, 1, 3}));
            }),
            "depth metrics: expected two batches of depth maps (views, height, width) of one shape, "
            "found [1, 1, 2] and [1, 1, 3]; resize the prediction to the truth.");
}

TEST(DepthMetrics, SayWhetherTheDepthWasScaledToTheTruth) {
  MetricInputs inputs;
  inputs.true_depth = torch::rand({2, 8, 9}) + 1;
  inputs.depth = inputs.true_depth / 5;
  const auto mean = [&](const char* name) { return measure(metric_named(name), inputs).mean(); };
  // Depth is known up to a factor, and the cameras say half of it.
  inputs.depth_scale = 2.5;
  EXPECT_NEAR(mean("depth_abs_rel_median_scaled"), 0, 1e-6);
  EXPECT_NEAR(mean("depth_delta1_median_scaled"), 1, 1e-12);
  EXPECT_NEAR(mean("depth_abs_rel_unscaled"), 0.5, 1e-6);
  EXPECT_NEAR(mean("depth_sq_rel_unscaled"), (inputs.true_depth / 4).mean().item<double>(), 1e-6);
  EXPECT_NEAR(mean("depth_rmse_unscaled"),
              (inputs.true_depth / 2).square().mean({1, 2}).sqrt().mean().item<double>(), 1e-6);
  EXPECT_NEAR(mean("depth_delta1_unscaled"), 0, 1e-12);
  inputs.depth_scale = 5;
  EXPECT_NEAR(mean("depth_abs_rel_unscaled"), 0, 1e-6);
}

TEST(DepthMetrics, AreAbsentWithoutAScaleOrATruth) {
  MetricInputs inputs;
  inputs.true_depth = inputs.depth = torch::ones({1, 4, 4});
  const auto absent = [&](const char* name) { return measure(metric_named(name), inputs).absent; };
  EXPECT_EQ(absent("depth_abs_rel_median_scaled"), "");
  EXPECT_EQ(absent("depth_abs_rel_unscaled"), "the scale of the predicted depth is unknown");
  inputs.depth_scale = 1;
  inputs.true_depth = torch::zeros({1, 4, 4});
  EXPECT_EQ(absent("depth_rmse_unscaled"), "no pixel of a target view has a true depth");
  inputs.true_depth = torch::ones({1, 4, 4});
  inputs.depth = torch::full({1, 4, 4}, kNaN);
  EXPECT_EQ(absent("depth_rmse_unscaled"), "the predicted depth is not finite");
  inputs.depth = torch::zeros({1, 4, 4});
  EXPECT_EQ(absent("depth_rmse_median_scaled"), "no predicted depth is positive where the true one is known");
}

}  // namespace
}  // namespace gld
