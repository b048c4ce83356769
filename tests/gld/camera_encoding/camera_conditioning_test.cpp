#include "gld/camera_encoding/camera_conditioning.h"

#include "gld/camera_encoding/prope.h"
#include "tests/support/error_of.h"
#include "tests/support/random_cameras.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(CameraConditioning, RaysOfAKnownCamera) {
  // Two cameras without rotation; the last is the reference, the first two units to its left.
  Camera camera;
  camera.width = 4;
  camera.height = 2;
  camera.intrinsics << 2, 0, 2, 0, 2, 1, 0, 0, 1;
  Views views;
  views.num_sources = 1;
  views.cameras = {camera, camera};
  views.cameras[0].world_from_camera.translation() = Eigen::Vector3d(3, 5, 7);
  views.cameras[1].world_from_camera.translation() = Eigen::Vector3d(5, 5, 7);
  const auto relative = relative_cameras(views);
  EXPECT_NEAR(relative.translation_scale, 0.5, 1e-8);
  const auto image = camera_conditioning(relative, PixelOffset{}, torch::kFloat64);
  ASSERT_EQ(image.sizes(), (std::vector<int64_t>{2, 7, 2, 4}));
  EXPECT_TRUE(image[0][0].eq(0).all().item<bool>());
  EXPECT_TRUE(image[1][0].eq(1).all().item<bool>());
  // The centre of pixel (column 3, row 0) is (3.5, 0.5): direction (0.75, -0.25, 1).
  const Eigen::Vector3d direction = Eigen::Vector3d(0.75, -0.25, 1).normalized();
  const Eigen::Vector3d moment = Eigen::Vector3d(-1, 0, 0).cross(direction);
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_NEAR(image[0][1 + axis][0][3].item<double>(), direction[axis], 1e-12);
    EXPECT_NEAR(image[0][4 + axis][0][3].item<double>(), moment[axis], 1e-7);
    EXPECT_EQ(image[1][4 + axis][0][3].item<double>(), 0);
  }
  // The published offset starts the ray of column 3 a pixel to the left.
  PixelOffset published;
  published.x = -0.5;
  const auto shifted = camera_conditioning(relative, published, torch::kFloat64);
  EXPECT_TRUE(torch::allclose(shifted.slice(3, 1), image.slice(3, 0, 3)));
}

TEST(CameraConditioning, TheMaskIsOneInTargetViewsAlone) {
  const Views views = test::RandomCameras(3).ordinary_scene({5, 3, 6, 4});
  for (const auto& image : {camera_conditioning(relative_cameras(views), {}, torch::kFloat32),
                            camera_conditioning_without_rays(views)}) {
    for (int64_t view = 0; view < 5; ++view) {
      EXPECT_TRUE(image[view][0].eq(view < 3 ? 0 : 1).all().item<bool>()) << view;
    }
  }
}

TEST(CameraConditioning, WithoutRaysOnlyTheMaskIsLeft) {
  const Views views = test::RandomCameras(1).ordinary_scene({3, 1, 6, 4});
  const auto image = camera_conditioning_without_rays(views);
  EXPECT_EQ(image.sum().item<double>(), 2 * 6 * 4);
  EXPECT_EQ(image.slice(0, 1).select(1, 0).sum().item<double>(), 2 * 6 * 4);
}

TEST(CameraConditioning, RefusesViewsOfSeveralSizes) {
  Views views = test::RandomCameras(2).ordinary_scene({2, 1, 6, 4});
  views.cameras[1].width = 5;
  EXPECT_EQ(test::error_of([&] { camera_conditioning(relative_cameras(views), {}); }),
            "camera conditioning: expected views of one size, 6 x 4, found 5 x 4; "
            "resize and crop all views to one size.");
}

}  // namespace
}  // namespace gld
