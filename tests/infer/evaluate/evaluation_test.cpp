#include "infer/evaluate/evaluation.h"

#include "tests/support/error_of.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace gld {
namespace {

SceneEvaluation scene(const std::string& name, double psnr) {
  SceneEvaluation result;
  result.scene = name;
  result.psnr = psnr;
  result.psnr_nearest_source = 14.0;
  result.psnr_mean_source = 15.5;
  result.psnr_mean_color = 13.0;
  result.ssim = 0.5;
  result.depth_abs_rel = 0.125;
  result.reconstruction_psnr = 27.0;
  return result;
}

TEST(Evaluation, TheTableHasTheColumnsInOrder) {
  EXPECT_EQ(evaluation_csv({scene("room_1", 18.25)}),
            "scene,psnr,psnr_nearest_source,psnr_mean_source,psnr_mean_color,ssim,depth_abs_rel,"
            "reconstruction_psnr\n"
            "room_1,18.250000,14.000000,15.500000,13.000000,0.500000,0.125000,27.000000\n");
}

TEST(Evaluation, TheSummaryNamesTheBestTrivialPredictor) {
  const auto summary = evaluation_summary({scene("a", 18.0), scene("b", 20.0)});
  EXPECT_EQ(summary.at("best_trivial_predictor"), "psnr_mean_source");
  EXPECT_NEAR(summary.at("margin_over_best_trivial_db").get<double>(), 3.5, 1e-12);
  EXPECT_NEAR(summary.at("means").at("psnr").at("mean").get<double>(), 19.0, 1e-12);
  // Standard deviation sqrt(2), standard error 1.
  EXPECT_NEAR(summary.at("means").at("psnr").at("confidence_95").get<double>(), 1.96, 1e-12);
}

TEST(Evaluation, AMeanLeavesOutWhatIsNotFinite) {
  const double none = std::numeric_limits<double>::quiet_NaN();
  const auto mean = mean_with_interval({1.0, none, 3.0});
  EXPECT_EQ(mean.mean, 2.0);
  EXPECT_EQ(mean.count, 2);
  EXPECT_TRUE(std::isnan(mean_with_interval({none}).mean));
}

TEST(Evaluation, RefusesToEvaluateNothing) {
  EvaluationOptions options;
  options.synthetic = 0;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "gld eval: expected scenes, found none; give --scenes DIR or --synthetic N.");
  options.synthetic = 1;
  options.views.most_sources = 4;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "views.most_sources: expected fewer sources than views, found 4; leave at least one target.");
}

}  // namespace
}  // namespace gld
