#include "gld/photogrammetry/shared_sight.h"

#include "tests/support/textured_plane.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::camera_before_plane;
using test::TexturedPlane;

int64_t count(const std::vector<uint8_t>& mask) {
  return std::accumulate(mask.begin(), mask.end(), int64_t{0});
}

TexturedPlane wall() {
  TexturedPlane plane;
  plane.normal = Eigen::Vector3d::UnitZ();
  return plane;
}

// The other camera stands as far to the right as a quarter of the picture is wide at the wall: 4 units away 96 pixels
// are 4 units.
TEST(SharedSight, IsWhatLiesInsideOfTheOtherPicture) {
  const std::vector<PicturedView> views{wall().seen_by(camera_before_plane({0, 0, 0}, 0), 1),
                                        wall().seen_by(camera_before_plane({1, 0, 0}, 0), 1)};
  const auto masks = in_sight_of_others(views);
  ASSERT_EQ(masks.size(), 2U);
  for (int64_t row = 0; row < 72; ++row) {
    for (int64_t column = 0; column < 96; ++column) {
      const auto pixel = static_cast<size_t>(row * 96 + column);
      ASSERT_EQ(masks[0][pixel], column >= 24 ? 1 : 0) << row << ", " << column;
      ASSERT_EQ(masks[1][pixel], column < 72 ? 1 : 0) << row << ", " << column;
    }
  }
}

// Something near to the other camera hides the wall from it.
TEST(SharedSight, IsNotWhatLiesBehindWhatTheOtherSees) {
  std::vector<PicturedView> views{wall().seen_by(camera_before_plane({0, 0, 0}, 0), 1),
                                  wall().seen_by(camera_before_plane({1, 0, 0}, 0), 1)};
  std::fill(views[1].depth.values.begin(), views[1].depth.values.end(), 2.0F);
  const auto masks = in_sight_of_others(views);
  EXPECT_EQ(count(masks[0]), 0);
  // What is near is seen by the first camera, before its wall: half of the picture further.
  EXPECT_EQ(count(masks[1]), 48 * 72);
}

TEST(SharedSight, IsNothingOfPixelsWithoutDepthOrOfOneViewAlone) {
  std::vector<PicturedView> views{wall().seen_by(camera_before_plane({0, 0, 0}, 0), 1),
                                  wall().seen_by(camera_before_plane({0.1, 0, 0}, 0), 1)};
  EXPECT_EQ(count(in_sight_of_others({views[0]})[0]), 0);
  views[0].depth.values.assign(views[0].depth.values.size(), NAN);
  EXPECT_EQ(count(in_sight_of_others(views)[0]), 0);
  EXPECT_EQ(count(in_sight_of_others(views)[1]), 0);
}

// The other camera has the wall at its back, whatever it sees before it.
TEST(SharedSight, IsNothingBehindTheOtherCamera) {
  std::vector<PicturedView> views{wall().seen_by(camera_before_plane({0, 0, 0}, 0), 1),
                                  wall().seen_by(camera_before_plane({0, 0, 8}, 0), 1)};
  std::fill(views[1].depth.values.begin(), views[1].depth.values.end(), 5.0F);
  EXPECT_EQ(count(in_sight_of_others(views)[0]), 0);
  EXPECT_EQ(count(in_sight_of_others(views)[1]), 0);
}

}  // namespace
}  // namespace gld
