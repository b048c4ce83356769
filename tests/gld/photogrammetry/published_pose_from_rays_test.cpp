#include "gld/photogrammetry/published_pose_from_rays.h"

#include "gld/cameras/pose_alignment.h"
#include "gld/photogrammetry/pose_from_rays.h"
#include "tests/support/error_of.h"
#include "tests/support/random_cameras.h"

#include <cmath>
#include <random>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr int64_t kWidth = 504, kHeight = 280, kColumns = 288,
                  kRows = 160;  // 8 cells a patch of 14 pixels, as heads have

// They look roughly along z, with the principal point in the middle; the first one is the world.
std::vector<Camera> cameras() {
  test::RandomCameras random(11);
  std::vector<Camera> result;
  for (int i = 0; i < 3; ++i) {
    Camera camera = random.ordinary(kWidth, kHeight);
    camera.intrinsics << 400, 0, kWidth / 2.0, 0, 420, kHeight / 2.0, 0, 0, 1;
    if (i == 0) camera.world_from_camera.setIdentity();
    result.push_back(camera);
  }
  return result;
}

enum class Cells { kMiddles, kWholeNumbers };

// In double a ray has direction = R K^-1 (u, v, 1), u and v in pixels of the picture.
RayGrid exact_rays(const Camera& camera, Cells cells) {
  RayGrid grid;
  grid.width = kColumns;
  grid.height = kRows;
  const double offset = cells == Cells::kMiddles ? 0.5 : 0;
  const Eigen::Matrix3d back = camera.world_from_camera.linear() * camera.intrinsics.inverse();
  for (int64_t row = 0; row < kRows; ++row) {
    for (int64_t column = 0; column < kColumns; ++column) {
      grid.directions.emplace_back(back *
                                   Eigen::Vector3d((static_cast<double>(column) + offset) * kWidth / kColumns,
                                                   (static_cast<double>(row) + offset) * kHeight / kRows, 1));
      grid.origins.emplace_back(camera.world_from_camera.translation());
      grid.confidence.push_back(2 + std::sin(static_cast<double>(row * column)));
    }
  }
  return grid;
}

// Every fifth ray looks and starts anywhere.
void add_outliers(RayGrid& grid) {
  std::mt19937_64 generator(7);
  std::normal_distribution<double> normal;
  for (size_t cell = 0; cell < grid.directions.size(); cell += 5) {
    for (int k = 0; k < 3; ++k) grid.directions[cell][k] = 3 * normal(generator);
  }
}

double rotation_error(const Camera& a, const Camera& b) {
  return rotation_angle(a.world_from_camera.linear(), b.world_from_camera.linear());
}
double centre_error(const Camera& a, const Camera& b) {
  return (a.world_from_camera.translation() - b.world_from_camera.translation()).norm();
}

TEST(CamerasFromRaysDa3, AreExactForExactRays) {
  const auto truth = cameras();
  std::vector<RayGrid> rays;
  rays.reserve(truth.size());
  for (const Camera& camera : truth) rays.push_back(exact_rays(camera, Cells::kMiddles));
  const auto found = cameras_from_rays_da3(rays, {kWidth, kHeight});
  for (size_t i = 0; i < truth.size(); ++i) {
    EXPECT_LT(rotation_error(found[i], truth[i]), 1e-5);
    EXPECT_LT(centre_error(found[i], truth[i]), 1e-7);
    EXPECT_LT((found[i].intrinsics - truth[i].intrinsics).norm() / 400, 1e-6);
  }
}

TEST(CamerasFromRaysDa3, ResistOutliersThatTheLinearFitDoesNot) {
  const auto truth = cameras();
  std::vector<RayGrid> middles, wholes;
  for (const Camera& camera : truth) {
    middles.push_back(exact_rays(camera, Cells::kMiddles));
    wholes.push_back(exact_rays(camera, Cells::kWholeNumbers));
  }
  for (size_t i = 1; i < truth.size(); ++i) {
    add_outliers(middles[i]);
    add_outliers(wholes[i]);
  }
  const auto robust = cameras_from_rays_da3(middles, {kWidth, kHeight});
  const auto linear = cameras_from_rays_gld(wholes, {kWidth, kHeight});
  for (size_t i = 1; i < truth.size(); ++i) {
    EXPECT_LT(rotation_error(robust[i], truth[i]), 0.05);
    EXPECT_GT(rotation_error(linear[i], truth[i]), 1);
  }
}

TEST(CamerasFromRaysGld, AreExactForExactRaysOfWholeCells) {
  const auto truth = cameras();
  std::vector<RayGrid> rays;
  rays.reserve(truth.size());
  for (const Camera& camera : truth) rays.push_back(exact_rays(camera, Cells::kWholeNumbers));
  const auto found = cameras_from_rays_gld(rays, {kWidth, kHeight});
  for (size_t i = 0; i < truth.size(); ++i) {
    EXPECT_LT(rotation_error(found[i], truth[i]), 1e-5);
    EXPECT_LT(centre_error(found[i], truth[i]), 1e-7);
    EXPECT_LT((found[i].intrinsics - truth[i].intrinsics).norm() / 400, 1e-6);
  }
}

// The published fault: where rays belong to the middles of cells, K is off by half a cell.
TEST(CamerasFromRaysGld, AreHalfACellOffForRaysOfMiddles) {
  const auto found = cameras_from_rays_gld({exact_rays(cameras()[0], Cells::kMiddles)}, {kWidth, kHeight});
  EXPECT_NEAR(found[0].intrinsics(0, 2), kWidth / 2.0 - 0.5 * kWidth / kColumns, 1e-6);
  EXPECT_NEAR(found[0].intrinsics(1, 2), kHeight / 2.0 - 0.5 * kHeight / kRows, 1e-6);
}

TEST(RayGrid, IsTheMapsRaysWithoutThoseThatAreNotFinite) {
  const Camera camera = cameras()[1];
  RayMap map = rays_of_camera(camera, kColumns, kRows);
  map.values[0] = std::nanf("");
  const RayGrid grid = ray_grid(map, {});
  EXPECT_EQ(grid.confidence[0], 0);
  EXPECT_EQ(grid.confidence[1], 1);
  const auto found = cameras_from_rays_da3({grid}, {kWidth, kHeight});
  EXPECT_LT(rotation_error(found[0], camera), 1e-4);  // float rays
  EXPECT_THAT(test::error_of([&] { ray_grid(map, ConfidenceMap(3, 3)); }),
              testing::HasSubstr("3x3 for 288x160"));
}

TEST(PublishedPoses, RefuseRaysThatNoCameraFits) {
  RayGrid none = exact_rays(cameras()[0], Cells::kMiddles);
  for (double& confidence : none.confidence) confidence = 0;
  EXPECT_THAT(
      test::error_of([&] {
        cameras_from_rays_da3({none}, {kWidth, kHeight});
      }),
      testing::HasSubstr("poses from rays, view 0: expected rays that a camera fits, found 0 usable rays"));
  EXPECT_THAT(test::error_of([&] {
                cameras_from_rays_gld({none}, {kWidth, kHeight});
              }),
              testing::HasSubstr("rays that do not spread"));
}

}  // namespace
}  // namespace gld
