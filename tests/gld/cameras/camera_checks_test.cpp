#include "gld/cameras/camera_checks.h"

#include "tests/support/error_of.h"
#include "tests/support/random_cameras.h"

#include <functional>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

Camera plain_camera() {
  Camera camera;
  camera.width = 84;
  camera.height = 56;
  camera.intrinsics << 80, 0, 42, 0, 80, 28, 0, 0, 1;
  return camera;
}

std::string refusal(const std::function<void(Camera&)>& change) {
  Camera camera = plain_camera();
  change(camera);
  return test::error_of([&] { check_camera(camera, "camera 3"); });
}

TEST(CameraChecks, AcceptsAPlainCamera) { EXPECT_NO_THROW(check_camera(plain_camera(), "camera 3")); }

TEST(CameraChecks, RefusesSizes) {
  EXPECT_EQ(refusal([](Camera& c) { c.width = 0; }),
            "camera 3: expected an image size of at least one pixel, found 0 x 56; "
            "give the width and height in pixels.");
}

TEST(CameraChecks, RefusesIntrinsics) {
  EXPECT_EQ(refusal([](Camera& c) { c.intrinsics(0, 2) = std::numeric_limits<double>::quiet_NaN(); }),
            "camera 3: expected finite intrinsics, found a number that is not finite; "
            "correct or leave out this camera.");
  EXPECT_EQ(refusal([](Camera& c) { c.intrinsics(1, 1) = -80; }),
            "camera 3: expected positive focal lengths in pixels, found fx = 80, fy = -80; "
            "give the intrinsics in OpenCV convention (x right, y down, z forward).");
  EXPECT_EQ(refusal([](Camera& c) { c.intrinsics(0, 0) = 0; }),
            "camera 3: expected positive focal lengths in pixels, found fx = 0, fy = 80; "
            "give the intrinsics in OpenCV convention (x right, y down, z forward).");
  for (const double widths : {1e-8, 1e8}) {
    EXPECT_THAT(refusal([&](Camera& c) { c.intrinsics(0, 0) = c.intrinsics(1, 1) = widths * 84; }),
                testing::MatchesRegex(
                    "camera 3: expected focal lengths of 0.001 to 10000 image widths, found 1e[-+]08; "
                    "give the intrinsics in pixels."));
  }
  EXPECT_EQ(
      refusal([](Camera& c) { c.intrinsics(0, 1) = 2; }),
      "camera 3: expected intrinsics of the form fx 0 cx, 0 fy cy, 0 0 1, found 80 2 42, 0 80 28, 0 0 1; "
      "undistort the images to a pinhole camera without skew.");
  EXPECT_EQ(
      refusal([](Camera& c) { c.intrinsics(2, 2) = 0; }),
      "camera 3: expected intrinsics of the form fx 0 cx, 0 fy cy, 0 0 1, found 80 0 42, 0 80 28, 0 0 0; "
      "undistort the images to a pinhole camera without skew.");
}

TEST(CameraChecks, RefusesPoses) {
  EXPECT_EQ(refusal([](Camera& c) {
              c.world_from_camera.translation().x() = std::numeric_limits<double>::infinity();
            }),
            "camera 3: expected a finite camera pose, found a number that is not finite; "
            "correct or leave out this camera.");
  EXPECT_EQ(refusal([](Camera& c) { c.world_from_camera.linear() *= 2; }),
            "camera 3: expected an orthonormal rotation, "
            "found rows and columns that miss unit length or right angles by 3; "
            "remove the scale or shear from the pose.");
  EXPECT_EQ(refusal([](Camera& c) { c.world_from_camera.linear()(2, 2) = -1; }),
            "camera 3: expected a right-handed rotation, found a mirrored one (determinant -1); "
            "flip one axis: poses are world-from-camera in OpenCV convention (x right, y down, z forward).");
}

TEST(CameraChecks, NamesTheCameraOfAScene) {
  Views views;
  views.num_sources = 1;
  views.cameras = {plain_camera(), plain_camera()};
  views.cameras[1].intrinsics(0, 0) = -1;
  EXPECT_EQ(test::error_of([&] { check_cameras(views, "scene 'door'"); }),
            "scene 'door', camera 1: expected positive focal lengths in pixels, found fx = -1, fy = 80; "
            "give the intrinsics in OpenCV convention (x right, y down, z forward).");
  views.num_sources = 0;
  EXPECT_EQ(test::error_of([&] { check_cameras(views, "scene 'door'"); }),
            "scene 'door': expected between 1 and 2 source views, found 0; name the source views.");
}

TEST(CameraChecks, WarnsInWords) {
  Views views;
  views.num_sources = 1;
  views.cameras = {plain_camera(), plain_camera()};
  views.cameras[0].world_from_camera.translation().x() = 1;
  EXPECT_TRUE(check_cameras(views, "scene").empty());
  views.cameras[0].intrinsics(0, 0) = 84 * 20;
  views.cameras[1].intrinsics(1, 2) = 60;
  views.cameras[0].world_from_camera.translation().x() = 0;
  EXPECT_EQ(check_cameras(views, "scene"),
            (std::vector<std::string>{"scene, camera 0: the focal length is 20 image widths",
                                      "scene, camera 0: the pixels are far from square (fx = 1680, fy = 80)",
                                      "scene, camera 1: the principal point (42, 60) is outside the image",
                                      "scene: the camera centres coincide, so there is no baseline: "
                                      "translations are taken as exactly zero"}));
}

TEST(CameraChecks, AcceptsEveryExtremeScene) {
  test::RandomCameras random(7);
  for (int i = 0; i < 2000; ++i) EXPECT_NO_THROW(check_cameras(random.extreme_scene(), "scene"));
}

}  // namespace
}  // namespace gld
