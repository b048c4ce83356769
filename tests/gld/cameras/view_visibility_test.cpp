#include "gld/cameras/view_visibility.h"

#include "gld/base/error.h"
#include "gld/cameras/convex_piece.h"
#include "tests/support/random_cameras.h"

#include <cmath>
#include <functional>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr double kPi = 3.14159265358979323846;
const Eigen::Vector3d kForward(0, 0, 1);
const Eigen::Vector3d kBackward(0, 0, -1);

// A camera at `eye` that looks along `forward`, y down in the picture; horizontal field of view in degrees.
Camera camera_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& forward, double field_of_view = 60) {
  Camera camera;
  camera.width = 112;
  camera.height = 84;
  const double focal = 56 / std::tan(field_of_view * kPi / 360);
  camera.intrinsics << focal, 0, 56, 0, focal, 42, 0, 0, 1;
  const Eigen::Vector3d z = forward.normalized();
  const Eigen::Vector3d x = Eigen::Vector3d(0, 1, 0).cross(z).normalized();
  camera.world_from_camera.linear().col(0) = x;
  camera.world_from_camera.linear().col(1) = z.cross(x);
  camera.world_from_camera.linear().col(2) = z;
  camera.world_from_camera.translation() = eye;
  return camera;
}

Views scene_of(const std::vector<Camera>& cameras, int64_t sources = 1) { return {cameras, sources}; }

Views orbit(int64_t count, int64_t sources) {
  Views views;
  views.num_sources = sources;
  for (int64_t i = 0; i < count; ++i) {
    const double angle = 2 * kPi * static_cast<double>(i) / static_cast<double>(count);
    const Eigen::Vector3d eye(std::sin(angle), 0, std::cos(angle));
    views.cameras.push_back(camera_at(eye, -eye));
  }
  return views;
}

void move(Views& views, double scale, const Eigen::Vector3d& offset) {
  for (Camera& camera : views.cameras) {
    auto centre = camera.world_from_camera.translation();
    centre = (scale * centre + offset).eval();
  }
}

PlanarDepth constant_depth(float value, int64_t width = 28, int64_t height = 21) {
  return {width, height, std::vector<float>(static_cast<size_t>(width * height), value)};
}

// What a camera sees in a corridor with the corners low and high.
PlanarDepth depth_in_box(const Camera& camera, const Eigen::Vector3d& low, const Eigen::Vector3d& high) {
  PlanarDepth depth{camera.width / 4, camera.height / 4, {}};
  for (int64_t row = 0; row < depth.height; ++row) {
    for (int64_t column = 0; column < depth.width; ++column) {
      const Eigen::Vector3d pixel(4 * static_cast<double>(column) + 2, 4 * static_cast<double>(row) + 2, 1);
      const Eigen::Vector3d ray = camera.world_from_camera.linear() * (camera.intrinsics.inverse() * pixel);
      double nearest = std::numeric_limits<double>::infinity();
      for (int axis = 0; axis < 3; ++axis) {
        const double wall = ray[axis] > 0 ? high[axis] : low[axis];
        if (ray[axis] == 0) continue;
        nearest = std::min(nearest, (wall - camera.world_from_camera.translation()[axis]) / ray[axis]);
      }
      depth.values.push_back(static_cast<float>(nearest));
    }
  }
  return depth;
}

// Whether a point, as a homogeneous vector, is inside both images, tried on random points between near and far.
bool some_point_is_seen_by_both(const Camera& a, const Camera& b, test::RandomCameras& random) {
  for (int i = 0; i < 2000; ++i) {
    const double depth = random.power(-2, 2);
    const Eigen::Vector3d pixel(random.uniform(0, static_cast<double>(a.width)),
                                random.uniform(0, static_cast<double>(a.height)), 1);
    const Eigen::Vector3d in_world = a.world_from_camera * (depth * (a.intrinsics.inverse() * pixel));
    const Eigen::Vector3d in_b = b.camera_from_world() * in_world;
    if (in_b.z() < 0.02 || in_b.z() > 90) continue;
    const Eigen::Vector3d at = b.intrinsics * in_b / in_b.z();
    if (at.x() > 0 && at.y() > 0 && at.x() < static_cast<double>(b.width) &&
        at.y() < static_cast<double>(b.height)) {
      return true;
    }
  }
  return false;
}

TEST(ConvexPiece, IntersectsExactlyWhereBoxesDo) {
  // Two pyramids side by side, 60 degrees wide, that begin to overlap at the depth 1.
  const double shift = 2 * std::tan(kPi / 6);
  const Camera left = camera_at({0, 0, 0}, kForward), right = camera_at({shift, 0, 0}, kForward);
  FrustumPart part;
  part.near = 0.1;
  for (const auto& [far, expected] : {std::pair{0.999, false}, {1.001, true}}) {
    part.far = far;
    EXPECT_EQ(intersects(frustum_piece(left, part), frustum_piece(right, part)), expected) << far;
  }
}

TEST(ConvexPiece, SkewEdgesNeedTheirCrossProducts) {
  // Needles that pass each other at a right angle: only the cross product of their edges separates them.
  FrustumPart part;
  part.near = 1;
  part.far = 9;
  for (const double apart : {0.2, 0.02}) {
    const Camera along = camera_at({0, 0, 0}, kForward, 1);
    const Camera across = camera_at({-5, apart, 5}, {1, 0, 0}, 1);
    // Half a degree at a distance of 5 is 0.044 wide, three quarters of it high.
    EXPECT_EQ(intersects(frustum_piece(along, part), frustum_piece(across, part)), apart < 0.06) << apart;
  }
}

TEST(ViewVisibility, AnOrbitAroundAnObjectKeepsAllPairs) {
  for (const int64_t count : {2, 3, 8}) {
    const auto visibility = view_visibility(orbit(count, 1));
    EXPECT_TRUE(visibility.all());
    EXPECT_EQ(visibility.kept(), 1);
    EXPECT_THAT(view_visibility_text(visibility), testing::HasSubstr("cameras alone"));
  }
}

TEST(ViewVisibility, AnOrbitKeepsAllPairsWithDepthToo) {
  // The room's walls lie two radii away; views from opposite sides see the air beside the object together.
  const Views views = orbit(8, 4);
  std::vector<PlanarDepth> depth;
  for (size_t i = 0; i < 4; ++i) depth.push_back(depth_in_box(views.cameras[i], {-2, -2, -2}, {2, 2, 2}));
  const auto visibility = view_visibility(views, depth);
  EXPECT_TRUE(visibility.used_depth);
  EXPECT_TRUE(visibility.all());
}

TEST(ViewVisibility, RoomsBackToBackAreApart) {
  // Views 0, 1, 4, 5 look into the one room, 2, 3, 6, 7 into the other.
  std::vector<Camera> cameras;
  for (int i = 0; i < 8; ++i) {
    const bool front = i / 2 % 2 == 0;
    cameras.push_back(camera_at({0.3 * i, 0, front ? 0.5 : -0.5}, front ? kForward : kBackward));
  }
  const auto visibility = view_visibility(scene_of(cameras, 4));
  for (int64_t a = 0; a < 8; ++a) {
    for (int64_t b = 0; b < 8; ++b) EXPECT_EQ(visibility.attends_to(a, b), a / 2 % 2 == b / 2 % 2);
  }
  EXPECT_EQ(visibility.kept(), 0.5);
  EXPECT_TRUE(visibility.lonely_targets.empty());
  const auto text = view_visibility_text(visibility);
  EXPECT_THAT(text, testing::HasSubstr("32 of 64 (50 %)"));
  EXPECT_THAT(text, testing::HasSubstr("view   0 ##..##..\n"));
}

// Four rooms in a row along z, 4 units long each, with walls between them; two views in each that look along the row.
Views row_of_rooms(std::vector<PlanarDepth>& source_depth) {
  std::vector<Camera> sources, targets;
  for (int room = 0; room < 4; ++room) {
    sources.push_back(camera_at({0, 0, 4.0 * room + 0.5}, kForward));
    targets.push_back(camera_at({0.3, 0, 4.0 * room + 0.8}, kForward));
    source_depth.push_back(depth_in_box(sources.back(), {-2, -1.5, 4.0 * room}, {2, 1.5, 4.0 * room + 4}));
  }
  Views views{sources, 4};
  views.cameras.insert(views.cameras.end(), targets.begin(), targets.end());
  return views;
}

TEST(ViewVisibility, DepthTellsRoomsInARowApartAndCamerasAloneDoNot) {
  std::vector<PlanarDepth> depth;
  const Views views = row_of_rooms(depth);
  EXPECT_TRUE(view_visibility(views).all());
  const auto visibility = view_visibility(views, depth);
  EXPECT_LT(visibility.kept(), 0.7);
  for (int64_t a = 0; a < 8; ++a) {
    for (int64_t b = 0; b < 8; ++b) {
      const int64_t rooms_between = std::abs(a % 4 - b % 4);
      if (rooms_between == 0) {
        EXPECT_TRUE(visibility.attends_to(a, b)) << a << " " << b;
      }
      // A source's space ends at the wall; a target's reaches twice the farthest surface, through one wall.
      if (rooms_between > (a < 4 && b < 4 ? 1 : 2)) {
        EXPECT_FALSE(visibility.attends_to(a, b)) << a << " " << b;
      }
    }
  }
}

TEST(ViewVisibility, NeitherOffsetNorUnitMatter) {
  std::vector<PlanarDepth> depth;
  const Views views = row_of_rooms(depth);
  const auto expected = view_visibility(views, depth);
  for (const auto& [scale, offset] : {std::pair{1.0, 1e6}, {1e-6, 0.0}, {1e8, 1e9}, {1e-8, 0.0}}) {
    Views moved = views;
    move(moved, scale, offset * Eigen::Vector3d(1, -0.5, 0.7));
    auto scaled = depth;
    for (auto& map : scaled) {
      for (float& value : map.values) value = static_cast<float>(value * scale);
    }
    EXPECT_EQ(view_visibility(moved, scaled).attends, expected.attends) << scale;
  }
}

TEST(ViewVisibility, TurningOnTheSpotDropsWhatLiesBehind) {
  // Sixteen directions around one place, 60 degrees wide and a tenth wider on each side.
  Views views;
  views.num_sources = 4;
  for (int i = 0; i < 16; ++i) {
    const int sixteenth = i % 4 * 4 + i / 4;  // the sources look to the four sides
    const double angle = kPi / 8 * sixteenth;
    views.cameras.push_back(camera_at({1e5, -3, 7}, {std::sin(angle), 0, std::cos(angle)}));
  }
  const auto visibility = view_visibility(views);
  for (int64_t a = 0; a < 16; ++a) {
    for (int64_t b = 0; b < 16; ++b) {
      int64_t steps = std::abs(a % 4 * 4 + a / 4 - b % 4 * 4 - b / 4);
      steps = std::min(steps, 16 - steps);
      // 1.2 times as wide an image is 69.4 degrees wide: 3 steps of 22.5 degrees overlap, 4 do not.
      EXPECT_EQ(visibility.attends_to(a, b), steps <= 3) << steps;
    }
  }
}

TEST(ViewVisibility, OppositeDirectionsAtOnePlaceStillGiveTheTargetItsSource) {
  const auto visibility =
      view_visibility(scene_of({camera_at({0, 0, 0}, kForward), camera_at({0, 0, 0}, kBackward)}));
  EXPECT_TRUE(visibility.all());
  EXPECT_THAT(visibility.lonely_targets, testing::ElementsAre(1));
}

TEST(ViewVisibility, ATargetThatSeesNoSourceGetsTheNearest) {
  // Two sources in different rooms look forward, the target looks back from behind the second.
  const auto visibility = view_visibility(scene_of(
      {camera_at({0, 0, 0}, kForward), camera_at({9, 0, 0}, kForward), camera_at({8, 0, -1}, kBackward)}, 2));
  EXPECT_FALSE(visibility.attends_to(2, 0));
  EXPECT_TRUE(visibility.attends_to(2, 1));
  EXPECT_THAT(visibility.lonely_targets, testing::ElementsAre(2));
}

TEST(ViewVisibility, OneSourceAndSevenTargets) {
  std::vector<Camera> cameras;
  for (int i = 0; i < 8; ++i) {
    const double angle = kPi / 4 * i;
    cameras.push_back(
        camera_at({0.2 * std::sin(angle), 0, 0.2 * std::cos(angle)}, {std::sin(angle), 0, std::cos(angle)}));
  }
  const auto visibility = view_visibility(scene_of(cameras));
  for (int64_t target = 1; target < 8; ++target) EXPECT_TRUE(visibility.attends_to(target, 0)) << target;
  EXPECT_FALSE(visibility.attends_to(2, 6));
  EXPECT_EQ(visibility.lonely_targets.size(), 5U);  // all but the two that look 45 degrees aside
}

TEST(ViewVisibility, ExtremeFocalLengths) {
  // Needles that are 1/50 wide: parallel ones side by side meet at 50 baselines, crossing ones where they cross.
  const double needle = 2 * std::atan(0.01) * 180 / kPi;
  const auto visibility = view_visibility(scene_of(
      {camera_at({0, 0, 0}, kForward, needle), camera_at({1, 0, 0}, kForward, needle),
       camera_at({-0.5, 0, 0.5}, {1, 0, 0}, needle), camera_at({-0.5, 0.3, 0.5}, {1, 0, 0}, needle)}));
  EXPECT_TRUE(visibility.attends_to(0, 1));
  EXPECT_TRUE(visibility.attends_to(0, 2));
  EXPECT_FALSE(visibility.attends_to(1, 3));
  // 169 degrees wide: even views that look apart meet, unless they look to opposite sides.
  const double wide = 2 * std::atan(10) * 180 / kPi;
  const auto around =
      view_visibility(scene_of({camera_at({0, 0, 0}, kForward, wide), camera_at({1, 0, 0}, {1, 0, 0}, wide),
                                camera_at({0, 0, -1}, kBackward, wide)},
                               2));
  EXPECT_TRUE(around.attends_to(0, 1));
  EXPECT_FALSE(around.attends_to(0, 2));
}

TEST(ViewVisibility, UnknownDepthIsNoReasonToDrop) {
  std::vector<PlanarDepth> depth;
  const Views views = row_of_rooms(depth);
  const auto with_walls = view_visibility(views, depth);
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  // Nothing known at all: as with cameras alone.
  std::vector<PlanarDepth> nothing(4, constant_depth(kNan));
  EXPECT_EQ(view_visibility(views, nothing).attends, view_visibility(views).attends);
  EXPECT_FALSE(view_visibility(views, nothing).used_depth);
  // One view without depth: its pairs can only become more.
  for (const float value : {kNan, 0.0F, -1.0F, std::numeric_limits<float>::infinity()}) {
    auto partly = depth;
    partly[1] = constant_depth(value);
    const auto visibility = view_visibility(views, partly);
    EXPECT_TRUE(visibility.used_depth);
    for (size_t i = 0; i < with_walls.attends.size(); ++i) {
      EXPECT_GE(visibility.attends[i], with_walls.attends[i]);
    }
  }
}

TEST(ViewVisibility, RefusesDepthThatDoesNotFit) {
  EXPECT_THROW(view_visibility(orbit(3, 2), {constant_depth(1)}), Error);
  EXPECT_THROW(view_visibility(orbit(3, 1), {PlanarDepth{4, 4, {1, 2}}}), Error);
  EXPECT_THROW(view_visibility(orbit(3, 1), {PlanarDepth{0, 0, {}}}), Error);
}

TEST(ViewVisibility, NothingThatBothSeeIsMissed) {
  test::RandomCameras random(11);
  int apart = 0, together = 0;
  for (int trial = 0; trial < 300; ++trial) {
    std::vector<Camera> cameras;
    cameras.reserve(3);
    for (int i = 0; i < 3; ++i) {
      cameras.push_back(camera_at(random.vector(1), random.vector(1), random.uniform(5, 120)));
    }
    // Every view is a source, so that no pair is kept for other reasons. A length of about 1 is the largest distance.
    const auto visibility = view_visibility(scene_of(cameras, 3));
    double extent = 0;
    for (const Camera& a : cameras) {
      for (const Camera& b : cameras) {
        extent =
            std::max(extent, (a.world_from_camera.translation() - b.world_from_camera.translation()).norm());
      }
    }
    for (Camera& camera : cameras) camera.world_from_camera.translation() /= extent;
    for (int64_t a = 0; a < 3; ++a) {
      for (int64_t b = 0; b < a; ++b) {
        const bool seen = some_point_is_seen_by_both(cameras[static_cast<size_t>(a)],
                                                     cameras[static_cast<size_t>(b)], random);
        if (seen) {
          EXPECT_TRUE(visibility.attends_to(a, b)) << trial;
        }
        (visibility.attends_to(a, b) ? together : apart) += 1;
      }
    }
  }
  EXPECT_GT(apart, 100);
  EXPECT_GT(together, 100);
}

TEST(ViewVisibility, ExtremeScenesKeepTheGuarantees) {
  test::RandomCameras random(5);
  for (int trial = 0; trial < 1000; ++trial) {
    const Views views = random.extreme_scene();
    std::vector<PlanarDepth> depth;
    if (trial % 2 == 0) {
      for (int64_t i = 0; i < views.num_sources; ++i) {
        auto map = constant_depth(0, 5, 3);
        for (float& value : map.values) value = static_cast<float>(random.power(-30, 30));
        depth.push_back(map);
      }
    }
    const auto visibility = view_visibility(views, depth);
    ASSERT_EQ(static_cast<int64_t>(visibility.attends.size()), views.size() * views.size());
    for (int64_t a = 0; a < views.size(); ++a) {
      EXPECT_TRUE(visibility.attends_to(a, a));
      bool source = false;
      for (int64_t b = 0; b < views.size(); ++b) {
        EXPECT_EQ(visibility.attends_to(a, b), visibility.attends_to(b, a));
        source = source || (b < views.num_sources && visibility.attends_to(a, b));
      }
      EXPECT_TRUE(source);
    }
    EXPECT_GT(visibility.kept(), 0);
    EXPECT_LE(visibility.kept(), 1);
  }
}

}  // namespace
}  // namespace gld
