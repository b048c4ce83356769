#include "infer/evaluate/evaluated_views.h"

#include "infer/request/held_out_scenes.h"
#include "tests/support/error_of.h"

#include <cstdint>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::HasSubstr;

Scene scene_of_frames(size_t frames) {
  Scene scene;
  scene.name = "film";
  scene.frames.resize(frames);
  return scene;
}

std::vector<int64_t> numbers_of(const std::vector<FrameChoice>& frames) {
  return {frames.begin(), frames.end()};
}

TEST(EvaluatedViews, TargetsAreTheSameForEveryNumberOfSources) {
  EvaluatedViews views;
  views.sampling = held_out_views();
  views.sampling.views = 8;
  views.sampling.shortest_interval = views.sampling.longest_interval = 1;
  views.source_counts = {1, 2, 4};
  check_evaluated_views(views);
  const auto found = evaluated_views(views, scene_of_frames(12), held_out_key(5, 0));
  ASSERT_EQ(found.size(), 3U);
  const auto four = numbers_of(found[2].sources);
  ASSERT_EQ(four.size(), 4U);
  EXPECT_EQ(numbers_of(found[1].sources), (std::vector<int64_t>{four[0], four[3]}));
  EXPECT_EQ(numbers_of(found[0].sources), (std::vector<int64_t>{four[0]}));
  EXPECT_EQ(four[3] - four[0], 7);  // the first view and the last
  EXPECT_EQ(found[0].targets.size(), 4U);
  for (const auto& selection : found) EXPECT_EQ(numbers_of(selection.targets), numbers_of(found[0].targets));
}

TEST(EvaluatedViews, GivenFramesAreTaken) {
  EvaluatedViews views;
  views.sampling = held_out_views();
  views.source_frames = {0, 5, 9};
  EXPECT_EQ(test::error_of([&] { check_evaluated_views(views); }),
            "--source-frames, --target-frames: expected both, or neither, found only sources; give both.");
  views.target_frames = {3, 4};
  views.source_counts = {3, 2};
  const auto found = evaluated_views(views, scene_of_frames(10), held_out_key(5, 0));
  EXPECT_EQ(numbers_of(found[0].sources), (std::vector<int64_t>{0, 5, 9}));
  EXPECT_EQ(numbers_of(found[1].sources), (std::vector<int64_t>{0, 9}));
  EXPECT_EQ(numbers_of(found[1].targets), (std::vector<int64_t>{3, 4}));
  views.source_counts = {4};
  EXPECT_THAT(test::error_of([&] { check_evaluated_views(views); }),
              HasSubstr("at most 3, the --source-frames"));
}

}  // namespace
}  // namespace gld
