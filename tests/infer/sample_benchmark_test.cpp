#include "infer/sample_benchmark.h"

#include "gld/atomic_file.h"
#include "models/random_bundle.h"
#include "tests/support/shared_data.h"

#include <cmath>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

// A small random model on a real scene: every variant has a row, errors refer to the converged solve of the same noise,
// and they fall with the evaluations.
TEST(SampleBenchmark, MeasuresEveryVariantAgainstTheReference) {
  const test::TemporaryFolder folder;
  const auto bundle = folder.path() / "bundle";
  write_random_bundle(bundle, small_bundle_options(), 5);
  SampleBenchmarkOptions options;
  options.model = bundle.string();
  options.scene = (test::shared_data() / "scenes" / "gld_layout_5e040cd0758dcc96").string();
  options.views.sources = {0, 7};
  options.views.targets = {3};
  options.size = "56x56";
  options.counts = {4, 32};
  options.guidance_scales = {1.5};
  options.reference_tolerance = 1e-4;
  options.threads = 1;
  options.out = (folder.path() / "run").string();
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_sample_benchmark(options), 0);
  const auto text = testing::internal::GetCapturedStdout();
  EXPECT_THAT(text, testing::HasSubstr("reference"));
  const std::filesystem::path run = options.out;
  for (const char* name :
       {"config.yaml", "sample.csv", "sample.md", "sample.svg", "sample.png", "report.json"}) {
    EXPECT_TRUE(std::filesystem::exists(run / name)) << name;
  }
  const auto csv = read_file(run / "sample.csv");
  EXPECT_EQ(
      csv.substr(0, csv.find('\n')),
      "scene,variant,guidance_scale,evaluations,unconditional,level1_error,level0_error,psnr,ssim,seconds,"
      "peak_bytes,non_finite");
  const auto level0_error = [&](const std::string& variant, const std::string& evaluations) {
    const auto at = csv.find("\"" + variant + "\",1.5," + evaluations + ",");
    if (at == std::string::npos) return std::numeric_limits<double>::quiet_NaN();
    size_t comma = at + variant.size() + 2;
    for (int i = 0; i < 4; ++i) comma = csv.find(',', comma + 1);
    return std::stod(csv.substr(comma + 1));
  };
  const double few = level0_error("unipc3, logsnr", "8"), many = level0_error("unipc3, logsnr", "64");
  EXPECT_LT(many, 0.01);
  EXPECT_LT(many, few / 5);
  EXPECT_LT(many, level0_error("euler, published", "64"));
}

TEST(SampleBenchmark, MeansAreOverScenesOfEqualVariants) {
  SampleRow one;
  one.scene = "a";
  one.variant = "euler, logsnr";
  one.evaluations = 12;
  one.level0_error = 0.1;
  one.peak_bytes = 5;
  SampleRow two = one;
  two.scene = "b";
  two.level0_error = 0.3;
  two.peak_bytes = 7;
  SampleRow other = one;
  other.evaluations = 24;
  const auto means = mean_over_scenes({one, two, other});
  ASSERT_EQ(means.size(), 2u);
  EXPECT_DOUBLE_EQ(means[0].level0_error, 0.2);
  EXPECT_EQ(means[0].evaluations, 12);
  EXPECT_EQ(means[0].peak_bytes, 7);
  EXPECT_EQ(means[1].evaluations, 24);
}

TEST(SampleBenchmark, RefusesToRunWithoutAScene) {
  SampleBenchmarkOptions options;
  EXPECT_EQ(
      error_of([&] { options.check(); }),
      "--scene: expected a folder of images with cameras, found nothing; add for example --scene my_photos.");
}

}  // namespace
}  // namespace gld
