#include "gld/metrics/metric.h"

#include "gld/base/atomic_file.h"
#include "gld/metrics/metric_list.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"

#include <cmath>
#include <limits>
#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

constexpr double kInfinite = std::numeric_limits<double>::infinity();
constexpr double kNotANumber = std::numeric_limits<double>::quiet_NaN();

TEST(MetricList, EveryMetricHasItsOwnNameAndSaysWhatIsMissing) {
  std::set<std::string> names;
  for (const Metric& metric : metric_list()) {
    EXPECT_TRUE(names.insert(metric.name).second) << metric.name;
    EXPECT_EQ(metric_named(metric.name).name, metric.name);
    const MetricValue value = measure(metric, MetricInputs());
    EXPECT_FALSE(value.absent.empty()) << metric.name;
    EXPECT_TRUE(std::isnan(value.mean())) << metric.name;  // never 0
  }
  EXPECT_EQ(image_metric_list().size(), 7u);
  EXPECT_EQ(test::error_of([] { metric_named("fid"); }),
            "metrics: expected the name of a metric, found 'fid'; choose among gld/metrics/metric_list.cpp.");
}

// Names, units and directions are columns of files that people have: those of the report beside the small model.
TEST(MetricList, KeepsTheColumnsOfARecordedReport) {
  const auto report = nlohmann::ordered_json::parse(
      read_file(test::source_root() / "configs" / "tiny" / "evaluation" / "report.json"));
  std::vector<std::string> listed, recorded;
  for (const Metric& metric : metric_list()) {
    if (metric.of_images() || metric.of_samples()) continue;
    if (metric.needs == std::vector{MetricNeed::kLatents}) continue;  // younger than that report
    listed.push_back(metric.name);
    const auto& column = report.at("means").at(metric.name);
    EXPECT_EQ(column.at("unit"), metric.unit) << metric.name;
    EXPECT_EQ(column.at("better"), better_name(metric.better)) << metric.name;
  }
  const std::set<std::string> names(listed.begin(), listed.end());
  for (const auto& [name, column] : report.at("means").items()) {
    if (names.count(name) != 0) recorded.push_back(name);
  }
  EXPECT_EQ(listed, recorded);
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
  const auto some = metric_of_views(torch::tensor({1.0, kNotANumber, 4.0}, torch::kFloat64), "none");
  EXPECT_EQ(some.mean(), 2.5);
  EXPECT_EQ(some.absent, "");
  EXPECT_EQ(metric_of_views(torch::tensor({kNotANumber}, torch::kFloat64), "none at all").absent,
            "none at all");
}

TEST(Metric, OnePerfectViewMakesThePsnrInfinite) {
  const auto truth = torch::rand({2, 3, 12, 12});
  auto images = truth.clone();
  images[1] = 1 - images[1];
  const auto value = measure_images(metric_named("psnr"), truth, images);
  EXPECT_EQ(value.per_view[0].item<double>(), kInfinite);
  EXPECT_TRUE(std::isfinite(value.per_view[1].item<double>()));
  EXPECT_EQ(value.mean(), kInfinite);
}

TEST(SceneStatistics, LeaveOutWhatIsNotFiniteAndCountIt) {
  const auto statistics = statistics_over_scenes({1.0, kNotANumber, 3.0, kInfinite});
  EXPECT_EQ(statistics.mean, 2.0);
  EXPECT_EQ(statistics.count, 2);
  EXPECT_EQ(statistics.infinite, 1);
  EXPECT_EQ(statistics.deviation, 1.0);                                 // population
  EXPECT_TRUE(std::isnan(statistics_over_scenes({kNotANumber}).mean));  // not 0
  EXPECT_EQ(statistics_over_scenes({2, kNotANumber, 2, kInfinite}).interval.high, 2);
}

TEST(SceneStatistics, IntervalHasTheWidthOfTheStandardErrorForManyScenes) {
  std::vector<double> values;
  values.reserve(400);
  for (int i = 0; i < 400; ++i) values.push_back(10 + (i % 2 == 0 ? 1.0 : -1.0));  // deviation 1
  const Interval interval = statistics_over_scenes(values).interval;
  // A percentile of 10,000 means scatters by 0.027 standard errors of 0.05; this is six of these.
  EXPECT_NEAR(interval.high - 10, 1.96 / 20, 0.008);
  EXPECT_NEAR(10 - interval.low, 1.96 / 20, 0.008);
}

TEST(SceneStatistics, IntervalFollowsSkew) {
  const Interval interval = statistics_over_scenes({1, 1, 1, 1, 1, 1, 1, 9}).interval;
  EXPECT_EQ(interval.low, 1);  // one of symmetric width would reach below every value
  EXPECT_GT(interval.high, 3);
}

TEST(SceneStatistics, OneSceneSaysNothingOfOthers) {
  EXPECT_TRUE(std::isnan(statistics_over_scenes({4}).interval.low));
  EXPECT_TRUE(std::isnan(statistics_over_scenes({}).interval.high));
}

}  // namespace
}  // namespace gld
