#include "infer/pipeline/photo_cameras.h"

#include "gld/cameras/pose_alignment.h"
#include "tests/support/error_of.h"
#include "tests/support/textured_plane.h"

#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;
using testing::HasSubstr;

std::vector<Camera> true_cameras() {
  return {test::camera_before_plane({0, 0, 0}, 0), test::camera_before_plane({0.7, 0.1, 0.1}, -0.15),
          test::camera_before_plane({-0.5, 0.2, 0.2}, 0.1)};
}

// What a perfect model says of photographs of the plane, in a frame of its own that is turned and in a unit of 2.
struct Photographed {
  GeometryOutput geometry;
  torch::Tensor photographs;
};

Photographed photographed_plane() {
  constexpr double kUnit = 2;
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(0.7, Vector3d(1, -2, 1).normalized()).toRotationMatrix();
  const test::TexturedPlane plane;
  std::vector<torch::Tensor> rays, depths, pictures;
  for (Camera camera : true_cameras()) {
    const PicturedView view = plane.seen_by(camera, kUnit);
    pictures.push_back(torch::tensor(view.rgb).view({view.height, view.width, 3}).permute({2, 0, 1}));
    depths.push_back(torch::tensor(view.depth.values).view({view.height, view.width}));
    camera.world_from_camera.linear() = turn * camera.world_from_camera.linear();
    camera.world_from_camera.translation() =
        (turn * camera.world_from_camera.translation() / kUnit + Vector3d(1, 2, 3)).eval();
    const RayMap map = rays_of_camera(camera, 32, 24);
    rays.push_back(torch::tensor(map.values).view({24, 32, 6}));
  }
  Photographed made;
  made.photographs = torch::stack(pictures);
  made.geometry.rays = torch::stack(rays);
  made.geometry.depth = torch::stack(depths);
  made.geometry.ray_confidence = torch::full({3, 24, 32}, 2.0F);
  made.geometry.depth_confidence = torch::full_like(made.geometry.depth, 2.0F);
  return made;
}

TEST(PhotoCameras, ExactRaysGiveTheCamerasExactly) {
  const Photographed plane = photographed_plane();
  const PhotoCameras found = photo_cameras(plane.geometry, plane.photographs);
  const auto truth = true_cameras();
  ASSERT_EQ(found.cameras.size(), 3U);
  EXPECT_EQ(found.cameras[0].world_from_camera.matrix(), Eigen::Matrix4d::Identity());
  for (size_t i = 0; i < 3; ++i) {
    const Camera& camera = found.cameras[i];
    EXPECT_LT((camera.intrinsics - truth[i].intrinsics).norm(), 1e-3);
    EXPECT_LT(rotation_angle(camera.world_from_camera.linear(), truth[i].world_from_camera.linear()), 1e-3);
    EXPECT_LT((2 * camera.world_from_camera.translation() - truth[i].world_from_camera.translation()).norm(),
              1e-5);
    EXPECT_LT(found.recovered[i].direction_error, 1e-3);
  }
  ASSERT_TRUE(found.depth_check.has_value());
  EXPECT_NEAR(found.depth_check->scale, 1, 0.03);
  EXPECT_THAT(found.doubts(), testing::IsEmpty());
  EXPECT_THAT(photo_cameras_text(found, {"a", "b", "c"}), HasSubstr("these cameras are sure"));
  EXPECT_EQ(photo_cameras_json(found, {"a", "b", "c"}).at("cameras").at(1).at("name"), "b");
}

// As the shipped model's rays are: directions are good, origins are rounding.
TEST(PhotoCameras, OriginsAtOnePlaceAreADoubt) {
  Photographed plane = photographed_plane();
  torch::manual_seed(1);
  plane.geometry.rays.narrow(3, 3, 3).copy_(1e-4 * torch::randn({3, 24, 32, 3}));
  const PhotoCameras found = photo_cameras(plane.geometry, plane.photographs);
  EXPECT_THAT(found.doubts(), testing::Contains(HasSubstr("origins of one photograph's rays scatter")));
  EXPECT_THAT(photo_cameras_text(found, {"a", "b", "c"}), HasSubstr("NOT sure"));
}

// Cameras whose distances do not go with the depth.
TEST(PhotoCameras, DepthThatDoesNotMatchIsADoubt) {
  Photographed plane = photographed_plane();
  plane.geometry.depth *= 2;
  const PhotoCameras found = photo_cameras(plane.geometry, plane.photographs);
  ASSERT_TRUE(found.depth_check.has_value());
  EXPECT_NEAR(found.depth_check->scale, 0.5, 0.02);
  EXPECT_THAT(found.doubts(), testing::Contains(HasSubstr("match at 0.50 times the predicted depth")));
}

TEST(PhotoCameras, NamesThePhotographThatNoCameraFits) {
  Photographed plane = photographed_plane();
  plane.geometry.rays[1].fill_(std::numeric_limits<float>::quiet_NaN());
  EXPECT_EQ(test::error_of([&] { photo_cameras(plane.geometry, plane.photographs); }),
            "photograph 1: expected rays that a camera fits, found 0; "
            "use another model, or let COLMAP find the cameras.");
}

}  // namespace
}  // namespace gld
