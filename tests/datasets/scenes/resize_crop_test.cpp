#include "datasets/scenes/resize_crop.h"

#include "datasets/scenes/frame_checks.h"
#include "gld/cameras/resized_camera.h"
#include "tests/support/error_of.h"

#include <cmath>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

namespace gld {
namespace {

Camera camera_of(int64_t width, int64_t height) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.intrinsics =
      intrinsic_matrix(700, 710, 0.48 * static_cast<double>(width), 0.53 * static_cast<double>(height));
  return camera;
}

TEST(ResizeCrop, ChoosesTheNearestAspect) {
  const std::vector<ImageSize> sizes{{504, 504}, {504, 378}, {504, 336}, {504, 280}};
  EXPECT_EQ(nearest_trained_size(1920, 1080, sizes).height, 280);
  EXPECT_EQ(nearest_trained_size(640, 480, sizes).height, 378);
  EXPECT_EQ(nearest_trained_size(1500, 1000, sizes).height, 336);
  EXPECT_EQ(nearest_trained_size(1296, 1936, sizes).height, 504);
  EXPECT_EQ(test::error_of([] { nearest_trained_size(4, 4, {}); }),
            "trained sizes: expected at least one size, found none; list the model's sizes.");
}

// A small white disc is drawn where a point projects; after resizing, its centre of mass must lie where the changed
// camera projects the same point.
TEST(ResizeCrop, IntrinsicsFollowThePixels) {
  const Camera camera = camera_of(801, 599);
  for (const auto& [size, about] : {std::pair{ImageSize{504, 280}, CropCentre::kImage},
                                    std::pair{ImageSize{112, 112}, CropCentre::kImage},
                                    std::pair{ImageSize{1000, 700}, CropCentre::kImage},
                                    std::pair{ImageSize{504, 280}, CropCentre::kPrincipalPoint},
                                    std::pair{ImageSize{112, 112}, CropCentre::kPrincipalPoint},
                                    std::pair{ImageSize{1000, 700}, CropCentre::kPrincipalPoint}}) {
    const Eigen::Vector3d point(0.05, -0.04, 1.0);
    const Eigen::Vector2d pixel = (camera.intrinsics * point).hnormalized();
    Image image(801, 599);
    for (int64_t y = 0; y < image.height; ++y) {
      for (int64_t x = 0; x < image.width; ++x) {
        const double distance =
            (Eigen::Vector2d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5) - pixel).norm();
        const double value = 255 * std::exp(-distance * distance / 200);
        for (int c = 0; c < 3; ++c) image.pixel(x, y)[c] = static_cast<uint8_t>(std::lround(value));
      }
    }
    const ResizeCrop plan = plan_resize_crop(camera, size, about);
    const Camera sized = resize_crop(camera, plan);
    const Image small = resize_crop(image, plan);
    ASSERT_EQ(small.width, size.width);
    ASSERT_EQ(small.height, size.height);
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();
    double mass = 0;
    for (int64_t y = 0; y < small.height; ++y) {
      for (int64_t x = 0; x < small.width; ++x) {
        const double value = small.pixel(x, y)[0];
        centre += value * Eigen::Vector2d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5);
        mass += value;
      }
    }
    const Eigen::Vector2d projected = (sized.intrinsics * point).hnormalized();
    EXPECT_LT((centre / mass - projected).norm(), 0.02) << size.width << "x" << size.height;
    EXPECT_NEAR(sized.intrinsics(0, 0) / sized.intrinsics(1, 1), 700.0 / 710.0, 5e-3);
  }
}

TEST(ResizeCrop, AboutThePrincipalPointTheLensLooksAlongTheMiddle) {
  Camera camera = camera_of(800, 600);
  camera.intrinsics = intrinsic_matrix(700, 700, 300.2, 350.4);
  // Columns 0 to 599 and rows 100 to 599 stay.
  const ResizeCrop plan = plan_resize_crop(camera, {120, 100}, CropCentre::kPrincipalPoint);
  EXPECT_EQ(plan.window_left, 0);
  EXPECT_EQ(plan.window_width, 600);
  EXPECT_EQ(plan.window_top, 100);
  EXPECT_EQ(plan.window_height, 500);
  const Camera sized = resize_crop(camera, plan);
  EXPECT_NEAR(sized.intrinsics(0, 2), 60.0 + 0.2 / 5, 1e-9);
  EXPECT_NEAR(sized.intrinsics(1, 2), 50.0 + 0.4 / 5, 1e-9);
  EXPECT_NEAR(sized.intrinsics(0, 0), 140.0, 1e-9);
  DepthMap depth(800, 600);
  for (int64_t y = 0; y < 600; ++y) {
    for (int64_t x = 0; x < 800; ++x) depth.at(x, y) = static_cast<float>(1000 * y + x);
  }
  EXPECT_EQ(resize_crop(depth, plan).at(0, 0), 102002);
  EXPECT_EQ(resize_crop(depth, plan).at(119, 99), 597597);
  camera.intrinsics(0, 2) = 150;
  EXPECT_EQ(
      test::error_of([&] {
        plan_resize_crop(camera, {120, 100}, CropCentre::kPrincipalPoint);
      }),
      "crop about the principal point: expected a principal point farther than a fifth of the picture's width "
      "(800 pixels) from its edges, found 150; crop about the image's centre (crop_centre: image).");
}

// A plan of its own for the larger size would round to other pixels: 11 of them at 18 times the size.
TEST(ResizeCrop, MagnifiedIsTheSameCropWithTheCameraOfTheSmallOne) {
  const Camera camera = camera_of(4032, 3024);
  const ImageSize size{112, 112};
  Frame frame;
  frame.camera = camera;
  frame.load_image = [] { return Image(4032, 3024); };
  const Camera small = load_sized(frame, size, FrameParts::kImage).camera;
  for (const int64_t times : {1, 4, 18}) {
    const SizedFrame large = load_magnified(frame, size, times);
    const Camera expected = resized_camera(small, times * 112, times * 112);
    EXPECT_EQ(large.image.width, times * 112);
    EXPECT_EQ(large.image.height, times * 112);
    EXPECT_LT((large.camera.intrinsics - expected.intrinsics).cwiseAbs().maxCoeff(), 1e-9) << times;
  }
  const Camera planned_apart = load_sized(frame, {18 * 112, 18 * 112}, FrameParts::kImage).camera;
  const Camera expected = resized_camera(small, 18 * 112, 18 * 112);
  EXPECT_GT((planned_apart.intrinsics - expected.intrinsics).cwiseAbs().maxCoeff(), 3);
}

TEST(ResizeCrop, DepthTakesTheNearestPixelAndNeverMixes) {
  DepthMap depth(6, 4);
  for (size_t i = 0; i < depth.metres.size(); ++i) depth.metres[i] = static_cast<float>(i + 1);
  const DepthMap half = resize_crop(depth, plan_resize_crop(6, 4, {3, 2}));
  EXPECT_EQ(half.metres, (std::vector<float>{8, 10, 12, 20, 22, 24}));
  const DepthMap cropped = resize_crop(depth, plan_resize_crop(6, 4, {4, 4}));
  EXPECT_EQ(cropped.at(0, 0), 2);
  EXPECT_EQ(cropped.at(3, 3), 23);
  const DepthMap doubled = resize_crop(depth, plan_resize_crop(6, 4, {12, 8}));
  EXPECT_EQ(doubled.at(1, 1), 1);
  EXPECT_EQ(doubled.at(2, 2), 8);
}

TEST(ResizeCrop, SameSizeChangesNothing) {
  const Camera camera = camera_of(504, 280);
  const ResizeCrop plan = plan_resize_crop(504, 280, {504, 280});
  EXPECT_EQ(resize_crop(camera, plan).intrinsics, camera.intrinsics);
  Image image(504, 280);
  image.rgb[1234] = 77;
  EXPECT_EQ(resize_crop(image, plan).rgb, image.rgb);
  EXPECT_EQ(test::error_of([&] { resize_crop(Image(5, 5), plan); }),
            "resize and crop: expected a picture of 504x280, found 5x5; "
            "use the picture that the plan was made for.");
}

}  // namespace
}  // namespace gld
