#include "gld/metrics/metric.h"

#include "gld/metrics/metric_list.h"
#include "tests/support/error_of.h"

#include <cmath>
#include <limits>
#include <set>

#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

TEST(MetricList, EveryMetricHasItsOwnNameAndSaysWhatIsMissing) {
  std::set<std::string> names;
  for (const Metric& metric : metric_list()) {
    EXPECT_TRUE(names.insert(metric.name).second) << metric.name;
    EXPECT_EQ(metric_named(metric.name).name, metric.name);
    const MetricValue value = measure(metric, MetricInputs());
    EXPECT_FALSE(value.absent.empty()) << metric.name;
    EXPECT_TRUE(std::isnan(value.mean())) << metric.name;  // never 0
  }
  EXPECT_EQ(image_metric_list().size(), 5u);
  EXPECT_EQ(test::error_of([] { metric_named("fid"); }),
            "metrics: expected the name of a metric, found 'fid'; choose among gld/metrics/metric_list.cpp.");
}

TEST(Metric, TheGivenReasonIsReported) {
  MetricInputs inputs;
  inputs.true_images = inputs.images = torch::rand({1, 3, 16, 16});
  inputs.missing[MetricNeed::kPerceptualDistance] = "no LPIPS weights were given";
  EXPECT_EQ(measure(metric_named("lpips"), inputs).absent, "no LPIPS weights were given");
  inputs.perceptual_distance = [](const torch::Tensor& a, const torch::Tensor& b) {
    return (a - b).abs().amax({1, 2, 3}) + 0.25;
  };
  EXPECT_EQ(measure(metric_named("lpips"), inputs).mean(), 0.25);
}

TEST(Metric, TheNetworkOfLpipsSeesImagesInItsRange) {
  MetricInputs inputs;
  inputs.true_images = torch::ones({1, 3, 16, 16});
  inputs.images = torch::full({1, 3, 16, 16}, 7);
  inputs.perceptual_distance = [](const torch::Tensor& a, const torch::Tensor& b) {
    return (a - b).abs().amax({1, 2, 3});
  };
  EXPECT_EQ(measure(metric_named("lpips"), inputs).mean(), 0);
}

TEST(Metric, TheMeanIsOverTheViewsThatHaveAValue) {
  const auto some = metric_of_views(torch::tensor({1.0, kNaN, 4.0}, torch::kFloat64), "none");
  EXPECT_EQ(some.mean(), 2.5);
  EXPECT_EQ(some.absent, "");
  EXPECT_EQ(metric_of_views(torch::tensor({kNaN}, torch::kFloat64), "none at all").absent, "none at all");
}

TEST(Metric, OnePerfectViewMakesThePsnrInfinite) {
  const auto truth = torch::rand({2, 3, 12, 12});
  auto images = truth.clone();
  images[1] = 1 - images[1];
  const auto value = measure_images(metric_named("psnr"), truth, images);
  EXPECT_EQ(value.per_view[0].item<double>(), kInfinity);
  EXPECT_TRUE(std::isfinite(value.per_view[1].item<double>()));
  EXPECT_EQ(value.mean(), kInfinity);
}

TEST(SceneStatistics, LeaveOutWhatIsNotFiniteAndCountIt) {
  const auto statistics = statistics_over_scenes({1.0, kNaN, 3.0, kInfinity});
  EXPECT_EQ(statistics.mean, 2.0);
  EXPECT_EQ(statistics.count, 2);
  EXPECT_EQ(statistics.infinite, 1);
  EXPECT_EQ(statistics.deviation, 1.0);                          // population
  EXPECT_NEAR(statistics.half_width, 1.96, 1e-12);               // sqrt(2) / sqrt(2)
  EXPECT_TRUE(std::isnan(statistics_over_scenes({kNaN}).mean));  // not 0
  EXPECT_EQ(statistics_over_scenes({5.0}).half_width, 0);
}

}  // namespace
}  // namespace gld
