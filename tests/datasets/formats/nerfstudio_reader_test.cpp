#include "datasets/formats/nerfstudio_reader.h"

#include "datasets/formats/depth_files.h"
#include "datasets/formats/json_file.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/images/image_file.h"
#include "datasets/scenes/frame_checks.h"
#include "datasets/scenes/lens_distortion.h"
#include "gld/base/atomic_file.h"
#include "tests/support/depth_png.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <gtest/gtest.h>

namespace gld {
namespace {

using nlohmann::json;
using test::error_of;
using test::TemporaryFolder;

class Nerfstudio : public ::testing::Test {
 protected:
  Nerfstudio() {
    std::filesystem::create_directories(folder_.path() / "images");
    // Listed in an order that is neither that of the names nor reversed.
    for (int i : {2, 10, 1}) {
      const std::string name = "images/frame_" + std::to_string(i) + ".png";
      write_png(folder_.path() / name, Image(40, 30));
      content_["frames"].push_back({{"file_path", name}, {"transform_matrix", pose(i)}});
    }
    content_["fl_x"] = 50;
    content_["fl_y"] = 51;
    content_["cx"] = 20.5;
    content_["cy"] = 14.5;
    content_["w"] = 40;
    content_["h"] = 30;
  }
  // In OpenGL's axes the camera is at (i, 0, 0), looking along -z.
  static json pose(double x) { return json::array({{1, 0, 0, x}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}}); }
  Scene open(const SceneReading& reading = {}) const {
    write_file_atomically(file(), content_.dump());
    return open_scene(folder_.path(), reading);
  }
  std::string error() const {
    return error_of([&] { open(); });
  }
  std::filesystem::path file() const { return folder_.path() / "transforms.json"; }
  TemporaryFolder folder_;
  json content_;
};

TEST_F(Nerfstudio, TurnsOpenGlIntoOpenCv) {
  const Scene scene = open();
  EXPECT_EQ(scene.format, "nerfstudio");
  ASSERT_EQ(scene.frames.size(), 3U);
  EXPECT_EQ(scene.frames[2].name, "frame_10");
  EXPECT_EQ(scene.frames[2].camera.world_from_camera.translation(), Eigen::Vector3d(10, 0, 0));
  // OpenCV's z is what the camera looks along, which was -z; its y points down.
  EXPECT_EQ(scene.frames[0].camera.world_from_camera.linear().col(2), Eigen::Vector3d(0, 0, -1));
  EXPECT_EQ(scene.frames[0].camera.world_from_camera.linear().col(1), Eigen::Vector3d(0, -1, 0));
  EXPECT_EQ(scene.frames[0].camera.intrinsics(1, 1), 51);
}

TEST_F(Nerfstudio, FramesMayHaveTheirOwnLens) {
  content_["frames"][2]["fl_x"] = 77;
  content_["frames"][2]["cx"] = 19;
  const Scene scene = open();
  EXPECT_EQ(scene.frames[0].camera.intrinsics(0, 0), 77);
  EXPECT_EQ(scene.frames[0].camera.intrinsics(0, 2), 19);
  EXPECT_EQ(scene.frames[1].camera.intrinsics(0, 0), 50);
}

TEST_F(Nerfstudio, FieldsOfViewInPlaceOfFocalLengths) {
  for (const char* key : {"fl_x", "fl_y", "cx", "cy", "w", "h"}) content_.erase(key);
  content_["camera_angle_x"] = 2 * std::atan(0.5);
  for (json& frame : content_["frames"]) {
    std::string path = frame["file_path"];
    frame["file_path"] = "./" + path.substr(0, path.size() - 4);  // as Blender scenes have it
  }
  const Scene scene = open();
  EXPECT_NEAR(scene.frames[0].camera.intrinsics(0, 0), 40, 1e-9);
  EXPECT_NEAR(scene.frames[0].camera.intrinsics(1, 1), 40, 1e-9);
  EXPECT_NEAR(scene.frames[0].camera.intrinsics(1, 2), 15, 1e-9);
}

TEST_F(Nerfstudio, SmallerImagesStandInForListedOnes) {
  content_["w"] = 160;
  content_["h"] = 120;
  for (const char* key : {"fl_x", "fl_y", "cx", "cy"}) content_[key] = content_[key].get<double>() * 4;
  std::filesystem::rename(folder_.path() / "images", folder_.path() / "images_4");
  const Scene scene = open();
  ASSERT_EQ(scene.frames.size(), 3U);
  EXPECT_EQ(scene.missing_files, 0);
  EXPECT_EQ(scene.frames[0].camera.width, 40);
  EXPECT_DOUBLE_EQ(scene.frames[0].camera.intrinsics(0, 0), 50);
  EXPECT_DOUBLE_EQ(scene.frames[0].camera.intrinsics(0, 2), 20.5);
}

TEST_F(Nerfstudio, AppliedTransformsAreUndone) {
  const Scene plain = open();
  // The usual exchange of axes that nerfstudio makes for COLMAP worlds, and a scale.
  content_["applied_transform"] = json::array({{1, 0, 0, 0.5}, {0, 0, 1, 0}, {0, -1, 0, 0}});
  content_["applied_scale"] = 2;
  Eigen::Matrix4d transform = json_pose(content_["applied_transform"], "test");
  for (json& frame : content_["frames"]) {
    Eigen::Matrix4d moved = transform * json_pose(frame["transform_matrix"], "test");
    moved.topRightCorner<3, 1>() *= 2;
    frame["transform_matrix"] = pose_to_json(moved);
  }
  // Depth is what nerfstudio multiplies by that scale, as it does points: without it, the unit of the plain poses.
  DepthMap depth(40, 30);
  for (float& value : depth.metres) value = 2.5F;
  write_depth_npy(folder_.path() / "d.npy", depth);
  content_["frames"][0]["depth_file_path"] = "d.npy";
  const Scene undone = open();
  for (const Frame& frame : undone.frames) {
    if (frame.has_depth()) {
      EXPECT_EQ(frame.depth().at(5, 5), 2.5F);
    }
  }
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_LT((undone.frames[i].camera.world_from_camera.matrix() -
               plain.frames[i].camera.world_from_camera.matrix())
                  .cwiseAbs()
                  .maxCoeff(),
              1e-12);
  }
  content_["applied_scale"] = 0;
  EXPECT_EQ(error(),
            file().string() + ": expected a positive applied_scale, found 0.000000; correct or remove it.");
}

TEST_F(Nerfstudio, MissingFilesAreCounted) {
  std::filesystem::remove(folder_.path() / "images" / "frame_2.png");
  const Scene scene = open();
  EXPECT_EQ(scene.frames.size(), 2U);
  EXPECT_EQ(scene.missing_files, 1);
  EXPECT_EQ(scene.warnings.back(), "1 of 3 listed files do not exist, the first is " +
                                       (folder_.path() / "images" / "frame_2.png").string() + ".");
  std::filesystem::remove_all(folder_.path() / "images");
  EXPECT_EQ(error(), folder_.path().string() +
                         ": expected at least one frame, found 3 listed files that do not exist, the first " +
                         (folder_.path() / "images" / "frame_1.png").string() +
                         "; check that images and cameras belong together.");
}

TEST_F(Nerfstudio, DepthAndMasks) {
  DepthMap depth(40, 30);
  for (float& value : depth.metres) value = 2.5F;
  test::write_depth_png(folder_.path() / "d.png", depth, 1e-3);
  Image mask(40, 30);
  for (size_t i = 0; i < mask.rgb.size() / 2; ++i) mask.rgb[i] = 255;
  write_png(folder_.path() / "mask.png", mask);
  content_["frames"][2]["depth_file_path"] = "d.png";
  content_["frames"][2]["mask_path"] = "mask.png";
  const Scene scene = open();
  EXPECT_NEAR(scene.frames[0].depth().at(5, 5), 2.5, 1e-6);
  EXPECT_FALSE(scene.frames[1].has_depth());
  EXPECT_EQ(scene.frames[0].validity().valid.front(), 1);
  EXPECT_EQ(scene.frames[0].validity().valid.back(), 0);
  // A .npy has the unit of the poses unless the file names one, which is of both.
  write_depth_npy(folder_.path() / "d.npy", depth);
  content_["frames"][2]["depth_file_path"] = "d.npy";
  EXPECT_NEAR(open().frames[0].depth().at(5, 5), 2.5, 1e-6);
  content_["depth_unit_scale_factor"] = 0.5;
  EXPECT_NEAR(open().frames[0].depth().at(5, 5), 1.25, 1e-6);
}

TEST_F(Nerfstudio, DamagedFiles) {
  content_["frames"][1]["transform_matrix"] = "none";
  EXPECT_EQ(error(), file().string() +
                         " frame 1 transform_matrix: expected a matrix of 3 or 4 rows of 4 numbers, "
                         "found something else; correct the matrix.");
  content_["frames"][1]["transform_matrix"] = pose(1);
  content_["camera_model"] = "EQUIRECTANGULAR";
  EXPECT_EQ(error(), file().string() +
                         " frame 2: expected camera_model OPENCV, OPENCV_FISHEYE, PINHOLE or SIMPLE_PINHOLE, "
                         "found EQUIRECTANGULAR; undistort the images first.");
  content_.erase("camera_model");
  content_.erase("fl_x");
  EXPECT_EQ(error(), file().string() +
                         " frame 2: expected fl_x or camera_angle_x, found neither; add the focal length.");
  content_["fl_x"] = "wide";
  EXPECT_EQ(error(),
            file().string() + " frame 2: expected a number as \"fl_x\", found \"wide\"; correct the value.");
  content_["fl_x"] = 0;
  EXPECT_EQ(error().substr(error().find(": ")),
            ": expected positive focal lengths, found fx 0 and fy 51; check the intrinsics.");
  content_["fl_x"] = 50;
  content_["frames"][0]["file_path"] = "/etc/passwd";
  EXPECT_EQ(error(), file().string() +
                         " frame 0: expected a path inside the scene's folder, found \"/etc/passwd\"; "
                         "make the path relative to the scene.");
  write_file_atomically(file(), "{\"frames\": [\n{\"transform_matrix\": [[NaN]]}]}");
  EXPECT_EQ(
      error_of([&] { open_scene(folder_.path()); }),
      file().string() +
          ":2: expected JSON, found NaN or Infinity, which are no JSON; write null or leave the value out.");
  write_file_atomically(file(), "{\"frames\": [\n\n");
  EXPECT_EQ(error_of([&] { open_scene(folder_.path()); }),
            file().string() + ":3: expected JSON, found a syntax error; correct the file.");
}

// A picture taken through a lens: position of every pixel of the ideal picture is known by its colour.
TEST_F(Nerfstudio, DistortionIsUndoneAndWhatTheLensDidNotSeeIsCroppedAway) {
  constexpr int kWidth = 160;
  constexpr int kHeight = 120;
  const double focal = 130;
  const auto shade = [](const Eigen::Vector2d& p) {
    return 127 + 60 * std::sin(9 * p.x()) * std::cos(7 * p.y());
  };
  // Barrel and pincushion: the second one's ideal picture has corners that the lens did not see.
  for (const double k1 : {-0.12, 0.12}) {
    LensDistortion lens;
    lens.model = LensModel::kRadialTangential;
    lens.k1 = k1;
    lens.k2 = 0.02;
    lens.p1 = 0.004;
    lens.p2 = -0.003;
    Image taken(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const Eigen::Vector2d seen((x + 0.5 - 80) / focal, (y + 0.5 - 60) / focal);
        Eigen::Vector2d ideal = seen;  // fixed-point inversion of the lens
        for (int i = 0; i < 50; ++i) ideal += seen - distorted(lens, ideal);
        for (int c = 0; c < 3; ++c) taken.pixel(x, y)[c] = static_cast<uint8_t>(std::lround(shade(ideal)));
      }
    }
    write_png(folder_.path() / "images" / "lens.png", taken);
    content_["frames"] = json::array({{{"file_path", "images/lens.png"}, {"transform_matrix", pose(0)}}});
    content_["fl_x"] = content_["fl_y"] = focal;
    content_["cx"] = 80;
    content_["cy"] = 60;
    content_["w"] = kWidth;
    content_["h"] = kHeight;
    content_["k1"] = lens.k1;
    content_["k2"] = lens.k2;
    content_["p1"] = lens.p1;
    content_["p2"] = lens.p2;
    const Scene scene = open();
    const Camera& camera = scene.frames[0].camera;
    const Image undone = scene.frames[0].image();
    ASSERT_EQ(undone.width, camera.width);
    ASSERT_EQ(undone.height, camera.height);
    const auto to_ray = [](const Eigen::Matrix3d& k, double x, double y) {
      return Eigen::Vector2d((x + 0.5 - k(0, 2)) / k(0, 0), (y + 0.5 - k(1, 2)) / k(1, 1));
    };
    const Eigen::Matrix3d stored = intrinsic_matrix(focal, focal, 80, 60);
    double worst_before = 0;
    for (int y = 0; y < undone.height; ++y) {
      for (int x = 0; x < undone.width; ++x) {
        // The outermost pixel of the picture taken stands for what lies up to half a pixel beyond its centre.
        const double tolerance = x < 2 || y < 2 || x + 2 >= undone.width || y + 2 >= undone.height ? 4 : 1.6;
        const double error = undone.pixel(x, y)[0] - shade(to_ray(camera.intrinsics, x, y));
        // Rounding to bytes twice and bilinear interpolation.
        ASSERT_LT(std::abs(error), tolerance) << k1 << " " << x << " " << y;
        worst_before = std::max(worst_before, std::abs(taken.pixel(x, y)[0] - shade(to_ray(stored, x, y))));
      }
    }
    EXPECT_GT(worst_before, 10);
    const ValidityMask valid = scene.frames[0].validity();
    EXPECT_EQ(std::count(valid.valid.begin(), valid.valid.end(), 0), 0);
    EXPECT_GT(camera.width * camera.height, kWidth * kHeight * 7 / 10);
    if (k1 > 0) {
      EXPECT_LT(camera.width * camera.height, kWidth * kHeight * 95 / 100);
      ASSERT_EQ(scene.warnings.size(), 1U);
      EXPECT_EQ(scene.warnings[0],
                "Pictures without their lens distortion have borders that the lens did not see: cropped away "
                "in 1 of them, the first from 160x120 to " +
                    std::to_string(camera.width) + "x" + std::to_string(camera.height) +
                    "; the intrinsics follow.");
    }
  }
}

}  // namespace
}  // namespace gld
