#include "gld/photogrammetry/leave_one_out.h"

#include "tests/support/textured_plane.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::camera_before_plane;

PicturedView photograph(const Camera& camera) {
  PicturedView view = test::TexturedPlane().seen_by(camera, 1);
  view.depth = {};
  return view;
}

// Views stand along a line, each turned a little towards the same place.
std::vector<PicturedView> row_of(int64_t count) {
  std::vector<PicturedView> views;
  for (int64_t i = 0; i < count; ++i) {
    const double place = static_cast<double>(i) - 0.5 * static_cast<double>(count - 1);
    views.push_back(photograph(camera_before_plane({0.35 * place, 0.05 * place, 0}, -0.06 * place)));
  }
  return views;
}

TEST(LeaveOneOut, TheOthersPredictAPhotographBetterThanTheNearestIs) {
  const auto left_out = leave_one_out(row_of(4), {});
  ASSERT_EQ(left_out.size(), 4U);
  for (const LeftOutPhotograph& one : left_out) {
    EXPECT_EQ(one.from.size(), 3U);
    EXPECT_GT(one.covered, 0.85) << one.view;
    // The waves' steepest slope is some 0.2 a pixel, so that a tenth of a pixel costs 34 dB at worst.
    EXPECT_GT(one.psnr_covered, 30) << one.view;
    EXPECT_GT(one.psnr_covered, one.psnr) << one.view;  // gaps are guessed
    EXPECT_GT(one.psnr, one.psnr_nearest + 5) << one.view;
    EXPECT_GT(one.psnr, one.psnr_mean + 5) << one.view;
  }
  // Nothing goes in that the left-out photograph says: another picture there changes no prediction, and each is worse.
  auto changed = row_of(4);
  for (float& value : changed[1].rgb) value = 1 - value;
  const auto other = leave_one_out(changed, {});
  EXPECT_EQ(other[1].covered, left_out[1].covered);
  EXPECT_LT(other[1].psnr, 12);
}

TEST(LeaveOneOut, OfTwoEachIsCarriedIntoTheOther) {
  const auto left_out = leave_one_out(row_of(2), {});
  ASSERT_EQ(left_out.size(), 2U);
  EXPECT_EQ(left_out[0].view, 0U);
  EXPECT_EQ(left_out[0].from, (std::vector<size_t>{1}));
  EXPECT_GT(left_out[0].psnr_covered, 28);
  EXPECT_EQ(left_out[0].psnr_mean, left_out[0].psnr_nearest);  // one is its own mean
  EXPECT_TRUE(leave_one_out(row_of(1), {}).empty());
}

TEST(LeaveOneOut, WhatNoOtherShowsIsNotCovered) {
  auto views = row_of(3);
  views[0] =
      photograph(camera_before_plane({0, 0, 0}, std::acos(-1.0)));  // behind it there is the plane as well
  const auto left_out = leave_one_out(views, {});
  EXPECT_EQ(left_out[0].covered, 0);
  EXPECT_TRUE(std::isnan(left_out[0].psnr_covered));
  const LeftOutPhotograph mean = mean_of(left_out);
  EXPECT_NEAR(mean.covered, (left_out[1].covered + left_out[2].covered) / 3, 1e-12);
  EXPECT_NEAR(mean.psnr_covered, 0.5 * (left_out[1].psnr_covered + left_out[2].psnr_covered), 1e-9);
}

TEST(LeaveOneOut, WrongCamerasShow) {
  auto views = row_of(4);
  const double right = mean_of(leave_one_out(views, {})).psnr;
  std::swap(views[1].camera, views[2].camera);
  EXPECT_LT(mean_of(leave_one_out(views, {})).psnr, right - 8);
}

TEST(LeaveOneOut, CostIsBounded) {
  LeaveOneOutOptions options;
  options.photographs = 3;
  options.neighbours = 2;
  options.stereo.planes = 32;
  options.block = 2;
  const auto left_out = leave_one_out(row_of(9), {}, options);
  ASSERT_EQ(left_out.size(), 3U);
  EXPECT_EQ(left_out[0].view, 1U);
  EXPECT_EQ(left_out[1].view, 4U);
  EXPECT_EQ(left_out[2].view, 7U);
  for (const LeftOutPhotograph& one : left_out) {
    ASSERT_EQ(one.from.size(), 2U);
    for (const size_t other : one.from)
      EXPECT_LE(std::abs(static_cast<int>(other) - static_cast<int>(one.view)), 1);
  }
}

}  // namespace
}  // namespace gld
