#include "datasets/scenes/view_sampling.h"

#include "datasets/loading/mixing.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <set>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

TEST(ViewSampling, IntervalsAreUniformAndIndependent) {
  ViewSampling sampling;
  sampling.shortest_interval = 2;
  sampling.longest_interval = 5;
  std::map<int64_t, int> intervals;
  std::map<std::pair<int64_t, int64_t>, int> pairs;
  std::map<int64_t, int> sources;
  std::array<int, 8> source_positions{};
  for (uint64_t index = 0; index < 4000; ++index) {
    const auto views = sample_views(sampling, 200, {1, 2, index});
    ASSERT_TRUE(views);
    ASSERT_EQ(views->frames.size(), 8U);
    std::vector<int64_t> sorted = views->frames;
    std::sort(sorted.begin(), sorted.end());
    EXPECT_GE(sorted.front(), 0);
    EXPECT_LT(sorted.back(), 200);
    for (size_t i = 1; i < sorted.size(); ++i) ++intervals[sorted[i] - sorted[i - 1]];
    ++pairs[{sorted[1] - sorted[0], sorted[2] - sorted[1]}];
    ++sources[views->num_sources];
    for (int64_t i = 0; i < views->num_sources; ++i) {
      const auto position = std::find(sorted.begin(), sorted.end(), views->frames[static_cast<size_t>(i)]);
      ++source_positions[static_cast<size_t>(position - sorted.begin())];
    }
  }
  ASSERT_EQ(intervals.size(), 4U);
  for (const auto& [interval, count] : intervals) EXPECT_NEAR(count, 7000, 250) << interval;
  ASSERT_EQ(pairs.size(), 16U);
  for (const auto& [pair, count] : pairs) EXPECT_NEAR(count, 250, 60) << pair.first << " " << pair.second;
  ASSERT_EQ(sources.size(), 4U);
  for (const auto& [count, times] : sources) EXPECT_NEAR(times, 1000, 110) << count;
  for (int count : source_positions) EXPECT_NEAR(count, 1250, 130);
}

// Of a scene, every frame from which the views still fit is the first one as often as any other.
TEST(ViewSampling, TheFirstFrameIsUniform) {
  ViewSampling sampling;
  sampling.views = 3;
  sampling.fewest_sources = sampling.most_sources = 1;
  sampling.shortest_interval = sampling.longest_interval = 2;
  std::map<int64_t, int> starts;
  for (uint64_t index = 0; index < 4000; ++index) {
    const auto views = sample_views(sampling, 12, {1, 2, index});
    ASSERT_TRUE(views);
    ++starts[*std::min_element(views->frames.begin(), views->frames.end())];
  }
  ASSERT_EQ(starts.size(), 8U);
  for (const auto& [start, count] : starts) EXPECT_NEAR(count, 500, 90) << start;
}

TEST(ViewSampling, IsAFunctionOfItsKey) {
  const ViewSampling sampling;
  const auto one = sample_views(sampling, 300, {5, 6, 7});
  const auto two = sample_views(sampling, 300, {5, 6, 7});
  EXPECT_EQ(one->frames, two->frames);
  EXPECT_EQ(one->num_sources, two->num_sources);
  std::set<std::vector<int64_t>> different;
  for (uint64_t i = 0; i < 50; ++i) {
    different.insert(sample_views(sampling, 300, {5, 6, i})->frames);
    different.insert(sample_views(sampling, 300, {5, i + 100, 7})->frames);
    different.insert(sample_views(sampling, 300, {i + 200, 6, 7})->frames);
    different.insert(sample_views(sampling, 300, {5, 6, 7, i + 1})->frames);
  }
  EXPECT_EQ(different.size(), 200U);
}

TEST(ViewSampling, ShortVideosShrinkTheIntervals) {
  const ViewSampling sampling;
  EXPECT_FALSE(sample_views(sampling, 7, {}));
  std::vector<int64_t> frames = sample_views(sampling, 8, {})->frames;
  std::sort(frames.begin(), frames.end());
  EXPECT_EQ(frames, (std::vector<int64_t>{0, 1, 2, 3, 4, 5, 6, 7}));
  for (uint64_t index = 0; index < 200; ++index) {
    const auto views = sample_views(sampling, 20, {0, 0, index});
    const std::set<int64_t> distinct(views->frames.begin(), views->frames.end());
    EXPECT_EQ(distinct.size(), 8U);
    EXPECT_LT(*distinct.rbegin(), 20);
  }
}

TEST(ViewSampling, ViewsComeInRandomOrderSourcesFirst) {
  ViewSampling shuffled, timed;
  shuffled.fewest_sources = shuffled.most_sources = timed.fewest_sources = timed.most_sources = 3;
  timed.order = ViewOrder::kTime;
  // It counts by how many of the views before it in time a view comes first among the sources, or last of all.
  std::array<int, 3> first{};
  std::array<int, 5> last{};
  for (uint64_t index = 0; index < 3000; ++index) {
    const auto views = sample_views(shuffled, 200, {1, 2, index})->frames;
    const auto in_time = sample_views(timed, 200, {1, 2, index})->frames;
    const auto sources_end = in_time.begin() + 3;
    EXPECT_TRUE(std::is_sorted(in_time.begin(), sources_end) && std::is_sorted(sources_end, in_time.end()));
    // The same views, sources and targets apart.
    EXPECT_TRUE(std::is_permutation(in_time.begin(), sources_end, views.begin()));
    EXPECT_TRUE(std::is_permutation(sources_end, in_time.end(), views.begin() + 3));
    ++first[static_cast<size_t>(std::find(in_time.begin(), sources_end, views.front()) - in_time.begin())];
    ++last[static_cast<size_t>(std::find(sources_end, in_time.end(), views.back()) - sources_end)];
  }
  for (const int count : first) EXPECT_NEAR(count, 1000, 110);
  for (const int count : last) EXPECT_NEAR(count, 600, 90);
}

TEST(ViewSampling, EvaluationModes) {
  ViewSampling sampling;
  sampling.views = 6;
  sampling.most_sources = 2;
  sampling.sources = SourceChoice::kInterpolate;
  // A video of as many frames as views leaves no choice of frames.
  const SampleKey key{1, 2, 3};
  const auto between = sample_views(sampling, 6, key);
  EXPECT_EQ(between->frames, (std::vector<int64_t>{0, 5, 1, 2, 3, 4}));
  EXPECT_EQ(between->num_sources, 2);
  sampling.most_sources = 3;
  EXPECT_EQ(sample_views(sampling, 6, key)->frames, (std::vector<int64_t>{0, 3, 5, 1, 2, 4}));
  sampling.sources = SourceChoice::kPrefix;
  EXPECT_EQ(sample_views(sampling, 6, key)->frames, (std::vector<int64_t>{0, 1, 2, 3, 4, 5}));
  EXPECT_EQ(sample_views(sampling, 6, key)->num_sources, 3);
  EXPECT_FALSE(sample_views(sampling, 5, key));
}

TEST(ViewSampling, ContradictionsAreRefused) {
  ViewSampling sampling;
  sampling.most_sources = 8;
  EXPECT_EQ(error_of([&] { sampling.check(); }),
            "most_sources: expected fewer than views (8), found 8; leave at least one target.");
  sampling.most_sources = 4;
  sampling.shortest_interval = 30;
  EXPECT_EQ(error_of([&] { sampling.check(); }),
            "longest_interval: expected at least shortest_interval (30), found 20; raise it.");
}

MixturePart part(const std::string& name, double weight) {
  SyntheticOptions options;
  options.scene_count = 7;
  MixturePart part;
  part.name = name;
  part.dataset = std::make_shared<SyntheticDataset>(options);
  part.weight = weight;
  return part;
}

TEST(Mixing, FollowsTheRatios) {
  const Mixture mixture({part("re10k", 4), part("dl3dv", 4), part("hypersim", 1), part("tartanair", 1)});
  std::array<int, 4> parts{};
  std::array<int, 7> scenes{};
  for (uint64_t index = 0; index < 20000; ++index) {
    const SampleChoice choice = mixture.choose({3, 0, index});
    ++parts[choice.part];
    ++scenes[static_cast<size_t>(choice.scene)];
  }
  EXPECT_NEAR(parts[0], 8000, 250);
  EXPECT_NEAR(parts[1], 8000, 250);
  EXPECT_NEAR(parts[2], 2000, 150);
  EXPECT_NEAR(parts[3], 2000, 150);
  for (int count : scenes) EXPECT_NEAR(count, 20000.0 / 7, 200);
}

TEST(Mixing, SizesFollowTheRatiosPerBatch) {
  const std::vector<WeightedSize> sizes{{{504, 504}, 2}, {{504, 378}, 2}, {{504, 336}, 1}, {{504, 280}, 1}};
  std::map<int64_t, int> heights;
  for (uint64_t batch = 0; batch < 12000; ++batch) {
    ++heights[choose_size(sizes, 9, batch).height];
  }
  EXPECT_NEAR(heights[504], 4000, 200);
  EXPECT_NEAR(heights[378], 4000, 200);
  EXPECT_NEAR(heights[336], 2000, 160);
  EXPECT_NEAR(heights[280], 2000, 160);
}

TEST(Mixing, RefusesWhatCannotBeMixed) {
  EXPECT_EQ(error_of([] { Mixture mixture({}); }),
            "dataset mixture: expected at least one dataset, found none; name one.");
  EXPECT_EQ(error_of([] { Mixture mixture({part("a", 0)}); }),
            "dataset a: expected a positive weight, found 0.000000; correct it or leave the entry out.");
  MixturePart other = part("b", 1);
  other.views.views = 6;
  EXPECT_EQ(
      error_of([&] {
        Mixture mixture({part("a", 1), other});
      }),
      "dataset b: expected 8 views as in the first dataset, found 6; use the same number of views for all "
      "datasets.");
}

}  // namespace
}  // namespace gld
