#include "gld/cameras/pose_encoding.h"

#include "tests/support/error_of.h"
#include "tests/support/random_cameras.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(PoseEncoding, GivesBackCamerasWhosePrincipalPointIsInTheMiddle) {
  test::RandomCameras random(1);
  for (int trial = 0; trial < 200; ++trial) {
    Camera camera = random.ordinary(84, 56);
    camera.world_from_camera.linear() = random.rotation(3.14);
    camera.intrinsics.block<2, 1>(0, 2) = Eigen::Vector2d(42, 28);
    const PoseEncoding encoding = pose_encoding(camera);
    EXPECT_GE(encoding[6], 0);
    EXPECT_NEAR(std::hypot(encoding[3], encoding[4], std::hypot(encoding[5], encoding[6])), 1, 1e-12);
    const Camera back = camera_of_pose_encoding(encoding, {84, 56});
    EXPECT_LT((back.world_from_camera.matrix() - camera.world_from_camera.matrix()).norm(), 1e-12);
    EXPECT_LT((back.intrinsics - camera.intrinsics).norm(), 1e-10);
    EXPECT_EQ(back.width, 84);
    EXPECT_EQ(back.height, 56);
  }
}

TEST(PoseEncoding, KnowsFieldsOfViewAndNoPixels) {
  Camera camera;
  camera.width = 200;
  camera.height = 100;
  camera.intrinsics << 100, 0, 70, 0, 50, 20, 0, 0, 1;
  const PoseEncoding encoding = pose_encoding(camera);
  EXPECT_NEAR(encoding[7], std::acos(-1.0) / 2, 1e-15);  // vertical: 100 pixels at a focal length of 50
  EXPECT_NEAR(encoding[8], std::acos(-1.0) / 2, 1e-15);
  Camera twice = camera;
  twice.width *= 2;
  twice.height *= 2;
  twice.intrinsics.topRows<2>() *= 2;
  EXPECT_EQ(pose_encoding(twice), encoding);
  const Camera other = camera_of_pose_encoding(encoding, {60, 80});
  EXPECT_NEAR(other.intrinsics(0, 0), 30, 1e-12);
  EXPECT_NEAR(other.intrinsics(1, 1), 40, 1e-12);
  EXPECT_EQ(other.intrinsics(0, 2), 30);
}

TEST(PoseEncoding, TakesQuaternionsOfAnyLengthAndSign) {
  const PoseEncoding unit = {1, 2, 3, 0.5, 0.5, 0.5, 0.5, 1, 1};
  PoseEncoding other = unit;
  for (size_t i = 3; i < 7; ++i) other[i] *= -7;
  EXPECT_LT((camera_of_pose_encoding(unit, {10, 10}).world_from_camera.matrix() -
             camera_of_pose_encoding(other, {10, 10}).world_from_camera.matrix())
                .norm(),
            1e-14);
}

TEST(PoseEncoding, FieldsOfViewWithoutAFocalLengthStayFinite) {
  for (const double angle : {0.0, -1.0, 3.2, 6.0}) {
    const Camera camera = camera_of_pose_encoding({0, 0, 0, 0, 0, 0, 1, angle, angle}, {10, 20});
    EXPECT_DOUBLE_EQ(camera.intrinsics(0, 0), 5e6) << angle;
    EXPECT_DOUBLE_EQ(camera.intrinsics(1, 1), 1e7) << angle;
  }
}

TEST(PoseEncoding, NumbersOfNoCameraAreRefused) {
  EXPECT_EQ(
      test::error_of([] {
        camera_of_pose_encoding({0, 0, 0, 0, 0, 0, 0, 1, 1}, {10, 10});
      }),
      "pose encoding: expected nine finite numbers with a quaternion that is not 0, found the quaternion 0; "
      "check the model's weights with gld inspect.");
  PoseEncoding broken = {0, 0, 0, 0, 0, 0, 1, 1, 1};
  broken[2] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(
      test::error_of([&] {
        camera_of_pose_encoding(broken, {10, 10});
      }),
      "pose encoding: expected nine finite numbers with a quaternion that is not 0, found NaN or infinity; "
      "check the model's weights with gld inspect.");
}

}  // namespace
}  // namespace gld
