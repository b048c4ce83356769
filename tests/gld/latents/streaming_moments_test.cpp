#include "gld/latents/streaming_moments.h"

#include "tests/support/error_of.h"

#include <limits>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Returns rows with a mean far from zero in channel 0 and a tiny spread in channel 1.
std::vector<float> hard_rows(int64_t rows) {
  std::mt19937 engine(3);
  std::normal_distribution<float> normal;
  std::vector<float> values;
  for (int64_t i = 0; i < rows; ++i) {
    values.push_back(5000.0F + normal(engine));
    values.push_back(56.0F + 0.01F * normal(engine));
    values.push_back(10.0F * normal(engine));
  }
  return values;
}

struct Direct {
  std::vector<double> mean, variance;
};

Direct direct_moments(const std::vector<float>& values, size_t channels) {
  Direct direct{std::vector<double>(channels), std::vector<double>(channels)};
  const size_t rows = values.size() / channels;
  for (size_t i = 0; i < values.size(); ++i)
    direct.mean[i % channels] += values[i] / static_cast<double>(rows);
  for (size_t i = 0; i < values.size(); ++i) {
    const double difference = values[i] - direct.mean[i % channels];
    direct.variance[i % channels] += difference * difference / static_cast<double>(rows);
  }
  return direct;
}

TEST(StreamingMoments, AgreeWithTwoPassesHoweverTheRowsAreSplit) {
  const int64_t rows = 10007;
  const auto values = hard_rows(rows);
  const auto direct = direct_moments(values, 3);
  for (const int64_t batch : {1L, 64L, 5000L, 20000L}) {
    StreamingMoments moments(3);
    for (int64_t first = 0; first < rows; first += batch) {
      moments.add(values.data() + 3 * first, std::min(batch, rows - first));
    }
    EXPECT_EQ(moments.count(), rows);
    const auto variance = moments.variance();
    for (size_t c = 0; c < 3; ++c) {
      EXPECT_NEAR(moments.mean()[c], direct.mean[c], 1e-11 * std::abs(direct.mean[c]) + 1e-12) << batch;
      EXPECT_NEAR(variance[c], direct.variance[c], 1e-9 * direct.variance[c]) << batch;
    }
  }
}

TEST(StreamingMoments, MergeFromSavedParts) {
  const auto values = hard_rows(1000);
  StreamingMoments whole(3), first(3), second(3);
  whole.add(values.data(), 1000);
  first.add(values.data(), 300);
  second.add(values.data() + 900, 700);
  StreamingMoments merged(first.count(), first.mean(), first.squares());
  merged.merge(second);
  merged.merge(StreamingMoments(3));
  EXPECT_EQ(merged.count(), 1000);
  for (size_t c = 0; c < 3; ++c) {
    EXPECT_NEAR(merged.mean()[c], whole.mean()[c], 1e-11 * 5000);
    EXPECT_NEAR(merged.variance()[c], whole.variance()[c], 1e-10 * whole.variance()[c]);
  }
}

TEST(StreamingMoments, RefuseWhatIsNoStatistic) {
  StreamingMoments moments(2);
  EXPECT_EQ(test::error_of([&] { moments.variance(); }),
            "latent statistics: expected at least one token, found none; give scenes with images.");
  EXPECT_EQ(
      test::error_of([&] { moments.merge(StreamingMoments(3)); }),
      "latent statistics: expected 2 channels, found 3; merge statistics of the same level and backbone.");
  const float rows[] = {1, std::numeric_limits<float>::infinity()};
  EXPECT_EQ(test::error_of([&] { moments.add(rows, 1); }),
            "latent statistics: expected finite features, found a number that is not finite in channel 1; "
            "check the images and the backbone's weights.");
}

}  // namespace
}  // namespace gld
