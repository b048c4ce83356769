#include "infer/run_export/depth_surface.h"

#include "tests/support/error_of.h"

#include <algorithm>
#include <cmath>
#include <set>

#include <gtest/gtest.h>

namespace gld {
namespace {

Camera camera_of(int64_t width, int64_t height) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.intrinsics << 40, 0, 9, 0, 50, 7.5, 0, 0, 1;
  return camera;
}

// A wall that leans away from the camera.
DepthMap slanted(int64_t width, int64_t height) {
  DepthMap depth(width, height);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x)
      depth.at(x, y) =
          static_cast<float>(1 / (0.5 - 0.012 * static_cast<double>(x) + 0.004 * static_cast<double>(y)));
  }
  return depth;
}

Eigen::Vector3d normal_of(const DepthSurface& surface, size_t triangle) {
  const auto corner = [&](size_t k) {
    return surface.x_in_camera[surface.corners[3 * triangle + k]].cast<double>().eval();
  };
  return (corner(1) - corner(0)).cross(corner(2) - corner(0));
}

TEST(DepthSurface, JoinsAllOfAPlane) {
  const Camera camera = camera_of(20, 15);
  const DepthSurface surface = depth_surface(slanted(20, 15), camera, {});
  EXPECT_EQ(surface.x_in_camera.size(), 300U);
  EXPECT_EQ(surface.corners.size(), 3U * 2 * 19 * 14);
  for (size_t i = 0; i < surface.x_in_camera.size(); ++i) {
    const Eigen::Vector3d x = surface.x_in_camera[i].cast<double>();
    // Each vertex is seen at the middle of a pixel, and its texture is there too.
    const double u = 40 * x.x() / x.z() + 9, v = 50 * x.y() / x.z() + 7.5;
    EXPECT_NEAR(u - std::floor(u), 0.5, 1e-4);
    EXPECT_NEAR(v - std::floor(v), 0.5, 1e-4);
    EXPECT_NEAR(surface.texture[i].x(), u / 20, 1e-5);
    EXPECT_NEAR(surface.texture[i].y(), v / 15, 1e-5);
  }
  for (size_t i = 0; i < surface.corners.size() / 3; ++i) {
    // Counter-clockwise for who looks along z with y down: the normal points at the camera.
    EXPECT_LT(normal_of(surface, i).z(), 0) << i;
  }
}

TEST(DepthSurface, IsCutAtSteps) {
  DepthMap depth = slanted(20, 15);
  for (int64_t y = 0; y < 15; ++y) {
    for (int64_t x = 0; x < 8; ++x) depth.at(x, y) *= 0.96F;  // less than 8 %: only what lies around tells it
  }
  const DepthSurface surface = depth_surface(depth, camera_of(20, 15), {});
  // All columns but the one across the step.
  EXPECT_EQ(surface.corners.size(), 3U * 2 * 18 * 14);
  std::set<float> across;
  for (size_t i = 0; i < surface.corners.size() / 3; ++i) {
    float left = 1, right = 0;
    for (size_t k = 0; k < 3; ++k) {
      left = std::min(left, surface.texture[surface.corners[3 * i + k]].x());
      right = std::max(right, surface.texture[surface.corners[3 * i + k]].x());
    }
    EXPECT_FALSE(left < 8.0F / 20 && right > 8.0F / 20);
  }
  // Where steps may be larger it is not cut.
  DepthSurfaceOptions lenient;
  lenient.edge_step = 0.5;
  EXPECT_EQ(depth_surface(depth, camera_of(20, 15), lenient).corners.size(), 3U * 2 * 19 * 14);
}

// Predicted depth goes from one surface to the next in a few pixels, none of which is steep.
TEST(DepthSurface, IsCutAtSmearedSteps) {
  DepthMap depth = slanted(20, 15);
  for (int64_t y = 0; y < 15; ++y) {
    for (int64_t x = 0; x < 11; ++x)
      depth.at(x, y) *= static_cast<float>(0.84 + 0.04 * std::max<double>(0, static_cast<double>(x) - 7));
  }
  const DepthSurface surface = depth_surface(depth, camera_of(20, 15), {});
  EXPECT_EQ(surface.corners.size(), 3U * 2 * 15 * 14);
  for (const auto& texture : surface.texture)
    EXPECT_FALSE(texture.x() > 8.0F / 20 && texture.x() < 11.0F / 20);
}

TEST(DepthSurface, IsCutAtStepsOfTheBorder) {
  DepthMap depth = slanted(20, 15);
  for (int64_t y = 0; y < 15; ++y) depth.at(0, y) *= 0.96F;
  EXPECT_EQ(depth_surface(depth, camera_of(20, 15), {}).corners.size(), 3U * 2 * 18 * 14);
}

TEST(DepthSurface, LeavesOutWhatIsUnknownOrFar) {
  DepthMap depth = slanted(20, 15);
  depth.at(5, 5) = 0;
  const DepthSurface hole = depth_surface(depth, camera_of(20, 15), {});
  EXPECT_EQ(hole.x_in_camera.size(), 299U);
  // The four cells around the hole keep the triangle that does not have it.
  EXPECT_EQ(hole.corners.size(), 3U * (2 * 19 * 14 - 4));
  DepthSurfaceOptions near;
  near.farthest = depth.at(9, 14);
  const DepthSurface cut = depth_surface(depth, camera_of(20, 15), near);
  EXPECT_LT(cut.x_in_camera.size(), 300U);
  for (const auto& x : cut.x_in_camera) EXPECT_LE(x.z(), near.farthest);
  EXPECT_TRUE(depth_surface(DepthMap(20, 15), camera_of(20, 15), {}).empty());
  DepthMap alone(20, 15);
  alone.at(3, 3) = 1;
  const DepthSurface nothing = depth_surface(alone, camera_of(20, 15), {});
  EXPECT_TRUE(nothing.empty());
  EXPECT_TRUE(nothing.x_in_camera.empty());
}

TEST(DepthSurface, TakesFewerPixels) {
  DepthSurfaceOptions options;
  options.step = 3;
  const DepthSurface surface = depth_surface(slanted(20, 15), camera_of(20, 15), options);
  EXPECT_EQ(surface.x_in_camera.size(), 7U * 5);
  for (size_t i = 0; i < surface.x_in_camera.size(); ++i) {
    const Eigen::Vector3d x = surface.x_in_camera[i].cast<double>();
    EXPECT_NEAR(1 / x.z(),
                0.5 - 0.012 * (40 * x.x() / x.z() + 9 - 0.5) + 0.004 * (50 * x.y() / x.z() + 7.5 - 0.5),
                1e-5);
  }
}

TEST(DepthSurface, RefusesInASentence) {
  EXPECT_EQ(test::error_of([] { depth_surface(slanted(20, 15), camera_of(20, 16), {}); }),
            "depth surface: expected depth of the camera's size 20x16, found 20x15; check what made it.");
  DepthSurfaceOptions none;
  none.step = 0;
  EXPECT_EQ(test::error_of([&] { depth_surface(slanted(20, 15), camera_of(20, 15), none); }),
            "depth surface: expected a step of a pixel or more, found 0; choose another.");
}

}  // namespace
}  // namespace gld
