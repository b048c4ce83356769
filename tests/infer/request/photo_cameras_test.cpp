#include "infer/request/photo_cameras.h"

#include "gld/cameras/pose_alignment.h"
#include "tests/support/error_of.h"
#include "tests/support/textured_plane.h"

#include <algorithm>
#include <limits>
#include <string>
#include <vector>

#include <fmt/format.h>
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

// focal_factor is that of the rays' camera against the true one, one a photograph.
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
  EXPECT_NEAR(found.lenses[0].focal_length(), focal, 1e-4);
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
  // Each has its own: what its rays ask for.
  const PhotoCameras own = photo_cameras(plane.geometry, plane.photographs,
                                         {{0, longer_side}, {1, longer_side}, {2, longer_side}});
  EXPECT_TRUE(own.lenses.empty());
  EXPECT_NEAR(own.cameras[2].intrinsics(0, 0), 1.3 * truth[2].intrinsics(0, 0), 1e-2);
}

// Rays that ask for less or more; photographs are four times as large as what the model sees.
class ExifFocalLength : public testing::Test {
 protected:
  // exif is over the true one, one a photograph; it is 0 where there is none.
  PhotoCameras found(const std::vector<double>& rays, const std::vector<int64_t>& lenses,
                     const std::vector<double>& exif) const {
    const Photographed plane = photographed_plane(rays);
    std::vector<PhotographLens> taken;
    for (size_t i = 0; i < lenses.size(); ++i)
      taken.push_back({lenses[i], kSide, exif[i] * kTrue / kSide, kTaken});
    return photo_cameras(plane.geometry, plane.photographs, taken);
  }
  static std::string pixels(double factor) { return fmt::format("{:.0f} px", factor * kTrue * kTaken); }

  const std::vector<std::string> names_{"a", "b", "c"};
  static inline const double kTrue = true_cameras()[0].intrinsics(0, 0);
  static inline const double kSide =
      static_cast<double>(std::max(true_cameras()[0].width, true_cameras()[0].height));
  static constexpr double kTaken = 4;
};

TEST_F(ExifFocalLength, IsTakenAndSaidBesideWhatTheModelSees) {
  const PhotoCameras cameras = found({0.9, 0.9, 1.2}, {0, 1, 2}, {1, 0, 1});
  const auto truth = true_cameras();
  for (const size_t i : {0, 2}) {
    EXPECT_LT((cameras.cameras[i].intrinsics - truth[i].intrinsics).norm(), 1e-9) << i;
    EXPECT_NEAR(cameras.focal_lengths[i].by_exif, kTaken * kTrue, 1e-9);
  }
  EXPECT_NEAR(cameras.cameras[1].intrinsics(0, 0), 0.9 * kTrue, 1e-2);
  EXPECT_EQ(cameras.focal_lengths[1].by_exif, 0);
  EXPECT_TRUE(cameras.lenses.empty());
  const std::string text = photo_cameras_text(cameras, names_);
  EXPECT_THAT(text, HasSubstr(" degrees wide (focal length " + pixels(1) + " by EXIF; the model sees " +
                              pixels(0.9) + "); its rays fit to "));
  EXPECT_THAT(text, HasSubstr(" degrees wide (the model sees a focal length of " + pixels(0.9) +
                              "; EXIF names none); its rays fit to 0.00 degrees, "));
  EXPECT_THAT(text,
              HasSubstr("(focal length " + pixels(1) + " by EXIF; the model sees " + pixels(1.2) + ")"));
  EXPECT_THAT(text, testing::Not(HasSubstr("by EXIF the focal length")));
  const auto json = photo_cameras_json(cameras, names_).at("cameras");
  EXPECT_NEAR(json[0].at("exif_focal_length_pixels").get<double>(), kTaken * kTrue, 1e-9);
  EXPECT_NEAR(json[0].at("seen_focal_length_pixels").get<double>(), 0.9 * kTaken * kTrue, 1e-2);
  EXPECT_FALSE(json[1].contains("exif_focal_length_pixels"));
  EXPECT_NEAR(json[1].at("seen_focal_length_pixels").get<double>(), 0.9 * kTaken * kTrue, 1e-2);
}

TEST_F(ExifFocalLength, IsThatOfAllPhotographsOfALens) {
  const PhotoCameras cameras = found({0.9, 1.05, 1.2}, {0, 0, 0}, {1, 1, 1});
  for (const Camera& camera : cameras.cameras) EXPECT_NEAR(camera.intrinsics(0, 0), kTrue, 1e-9);
  EXPECT_THAT(
      photo_cameras_text(cameras, names_),
      HasSubstr(fmt::format("\n  one lens took 3 of them: its focal length is {:.3f} of the longer side (by "
                            "EXIF; the model sees {:.3f}, {:.3f} to {:.3f} by each alone)\n",
                            kTrue / kSide, 1.05 * kTrue / kSide, 0.9 * kTrue / kSide, 1.2 * kTrue / kSide)));
  const auto lens = photo_cameras_json(cameras, names_).at("shared_lenses").at(0);
  EXPECT_NEAR(lens.at("focal_length").get<double>(), kTrue / kSide, 1e-9);
  EXPECT_EQ(lens.at("exif_focal_length"), lens.at("focal_length"));
  EXPECT_NEAR(lens.at("seen_focal_length").get<double>(), 1.05 * kTrue / kSide, 1e-4);
}

TEST_F(ExifFocalLength, FarFromWhatTheModelSeesIsADoubt) {
  using testing::AllOf;
  using testing::Contains;
  using testing::Each;
  using testing::Not;
  // The model sees rays of a camera, only not of EXIF's, which is one doubt and not two.
  const auto no_other =
      Each(Not(testing::AnyOf(HasSubstr("fit no camera"), HasSubstr("ask for focal lengths"))));
  EXPECT_THAT(
      found({1, 1, 1}, {0, 1, 2}, {0, 0.5, 1}).doubts(),
      AllOf(Contains("by EXIF the focal length of photograph 1 is 0.50 times what the model sees, as in "
                     "pictures that were cropped (without EXIF the model's is taken)"),
            no_other));
  EXPECT_THAT(
      found({1, 1, 1}, {0, 1, 2}, {1, 1, 1.8}).doubts(),
      AllOf(Contains("by EXIF the focal length of photograph 2 is 1.80 times what the model sees (without "
                     "EXIF the model's is taken)"),
            no_other));
  EXPECT_THAT(
      found({1, 0.9, 0.7}, {0, 0, 0}, {0.5, 0.5, 0.5}).doubts(),
      AllOf(Contains("by EXIF the focal length of 3 photographs is 0.50 to 0.71 times what the model sees, "
                     "as in pictures that were cropped (without EXIF the model's is taken)"),
            no_other));
  EXPECT_THAT(found({1, 1, 1}, {0, 1, 2}, {1, 1, 1}).doubts(), testing::IsEmpty());
}

// A picture of half the size from the same lens has the same focal length over its longer side.
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
