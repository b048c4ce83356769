#include "infer/request/photo_cameras.h"

#include "gld/cameras/pose_alignment.h"
#include "tests/support/error_of.h"
#include "tests/support/textured_plane.h"

#include <algorithm>
#include <limits>
#include <vector>

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

// focal_factor: of the rays' camera against the true one, one a photograph.
Photographed photographed_plane(const std::vector<double>& focal_factor = {1, 1, 1}) {
  constexpr double kUnit = 2;
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(0.7, Vector3d(1, -2, 1).normalized()).toRotationMatrix();
  const test::TexturedPlane plane;
  std::vector<torch::Tensor> rays, depths, pictures;
  auto factor = focal_factor.begin();
  for (Camera camera : true_cameras()) {
    const PicturedView view = plane.seen_by(camera, kUnit);
    pictures.push_back(torch::tensor(view.rgb).view({view.height, view.width, 3}).permute({2, 0, 1}));
    depths.push_back(torch::tensor(view.depth.values).view({view.height, view.width}));
    camera.world_from_camera.linear() = turn * camera.world_from_camera.linear();
    camera.world_from_camera.translation() =
        (turn * camera.world_from_camera.translation() / kUnit + Vector3d(1, 2, 3)).eval();
    camera.intrinsics.topLeftCorner<2, 2>() *= *factor++;
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

TEST(PhotoCameras, PhotographsOfOneLensGetOneFocalLength) {
  const Photographed plane = photographed_plane({0.9, 1, 1.3});
  const auto longer_side =
      static_cast<double>(std::max(plane.photographs.size(2), plane.photographs.size(3)));
  const std::vector<PhotographLens> one_lens(3, {0, longer_side});
  const PhotoCameras found = photo_cameras(plane.geometry, plane.photographs, one_lens);
  const auto truth = true_cameras();
  ASSERT_EQ(found.lenses.size(), 1U);
  EXPECT_EQ(found.lenses[0].photographs, (std::vector<size_t>{0, 1, 2}));
  const double focal = truth[0].intrinsics(0, 0) / longer_side;
  EXPECT_NEAR(found.lenses[0].focal_length, focal, 1e-4);
  EXPECT_NEAR(found.lenses[0].lowest, 0.9 * focal, 1e-4);
  EXPECT_NEAR(found.lenses[0].highest, 1.3 * focal, 1e-4);
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_LT((found.cameras[i].intrinsics - truth[i].intrinsics).norm(), 1e-2) << i;
    EXPECT_LT(
        rotation_angle(found.cameras[i].world_from_camera.linear(), truth[i].world_from_camera.linear()),
        0.5);
  }
  EXPECT_THAT(photo_cameras_text(found, {"a", "b", "c"}), HasSubstr("one lens took 3 of them"));
  EXPECT_EQ(photo_cameras_json(found, {"a", "b", "c"}).at("shared_lenses").size(), 1U);
  // Each its own: what its rays ask for.
  const PhotoCameras own = photo_cameras(plane.geometry, plane.photographs,
                                         {{0, longer_side}, {1, longer_side}, {2, longer_side}});
  EXPECT_TRUE(own.lenses.empty());
  EXPECT_NEAR(own.cameras[2].intrinsics(0, 0), 1.3 * truth[2].intrinsics(0, 0), 1e-2);
}

// A picture of half the size from the same lens: the same focal length over its longer side.
TEST(PhotoCameras, FocalLengthsOfOneLensFollowTheSizeOfThePhotograph) {
  const Photographed plane = photographed_plane({1, 1, 2});
  const auto side = static_cast<double>(std::max(plane.photographs.size(2), plane.photographs.size(3)));
  const PhotoCameras found =
      photo_cameras(plane.geometry, plane.photographs, {{0, side}, {0, side}, {0, 2 * side}});
  ASSERT_EQ(found.lenses.size(), 1U);
  EXPECT_NEAR(found.lenses[0].lowest, found.lenses[0].highest, 1e-4);
  EXPECT_NEAR(found.cameras[2].intrinsics(0, 0), 2 * true_cameras()[2].intrinsics(0, 0), 1e-2);
}

TEST(PhotoCameras, LensesThatDifferAreADoubtWhereOneIsAskedFor) {
  const Photographed plane = photographed_plane({0.7, 1, 1.4});
  const std::vector<PhotographLens> one_lens(3, {0, 100.0});
  EXPECT_THAT(photo_cameras(plane.geometry, plane.photographs, one_lens).doubts(),
              testing::Contains(HasSubstr("the 3 photographs of one lens ask for focal lengths from")));
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
