#include "datasets/formats/npz_reader.h"

#include "datasets/formats/scene_reader.h"
#include "datasets/images/image_file.h"
#include "gld/base/atomic_file.h"
#include "gld/files/npy.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cmath>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;
using test::test_data;

TEST(NpzReader, ReadsTheRealClip) {
  const Scene scene = open_scene(test_data() / "scenes" / "gld_layout_5e040cd0758dcc96");
  EXPECT_EQ(scene.format, "npz");
  ASSERT_EQ(scene.frames.size(), 8U);
  EXPECT_EQ(scene.frames[3].name, "frame_00003");
  EXPECT_TRUE(scene.warnings.empty());
  for (const Frame& frame : scene.frames) {
    EXPECT_EQ(frame.camera.width, 504);
    EXPECT_EQ(frame.camera.height, 280);
    EXPECT_NEAR(frame.camera.intrinsics(0, 2), 252, 1e-3);
    EXPECT_NEAR(frame.camera.intrinsics(1, 2), 140, 1e-3);
    EXPECT_NEAR(frame.camera.world_from_camera.linear().determinant(), 1, 1e-12);
    EXPECT_FALSE(frame.has_depth());
    EXPECT_EQ(frame.image().rgb.size(), 3U * 504 * 280);
  }
  EXPECT_EQ(scene.frames[0].validity().valid.size(), 504U * 280);
  EXPECT_EQ(error_of([&] { scene.frames[0].depth(); }),
            "frame_00000: expected depth, found none; choose a frame that has it.");
}

TEST(NpzReader, TheImageFolderItselfIsAScene) {
  const Scene scene =
      open_scene(test_data() / "scenes" / "gld_layout_5e040cd0758dcc96" / "nerfstudio" / "images_4");
  EXPECT_EQ(scene.frames.size(), 8U);
}

class DamagedNpzScene : public ::testing::Test {
 protected:
  DamagedNpzScene() {
    std::filesystem::create_directories(images());
    for (int i = 0; i < 3; ++i) {
      write_png(images() / ("frame_" + std::to_string(i) + ".png"), Image(20, 10));
      write_camera(i, {16, 0, 10, 0, 16, 5, 0, 0, 1}, pose());
    }
  }
  std::filesystem::path images() const { return folder_.path() / "images_4"; }
  std::string camera_file(int i) const {
    return (images() / ("frame_" + std::to_string(i) + ".npz")).string();
  }
  static std::vector<double> pose() { return {1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}; }
  void write_camera(int i, const std::vector<double>& intrinsic, const std::vector<double>& pose_values) {
    write_npz(camera_file(i), {{"intrinsic", npy_from_doubles({3, 3}, intrinsic.data())},
                               {"pose", npy_from_doubles({4, 4}, pose_values.data())}});
  }
  std::string error() const {
    return error_of([&] { open_scene(folder_.path()); });
  }
  TemporaryFolder folder_;
};

TEST_F(DamagedNpzScene, NotANumberInAPose) {
  auto bad = pose();
  bad[3] = std::nan("");
  write_camera(1, {16, 0, 10, 0, 16, 5, 0, 0, 1}, bad);
  EXPECT_EQ(error(), camera_file(1) +
                         ": expected a finite pose, found a value that is not a number or infinite; "
                         "leave the frame out.");
  SceneReading reading;
  reading.broken_frames = BrokenFrames::kSkip;
  const Scene scene = open_scene(folder_.path(), reading);
  EXPECT_EQ(scene.frames.size(), 2U);
  EXPECT_EQ(scene.broken_frames, 1);
  ASSERT_EQ(scene.warnings.size(), 2U);  // and that a number is missing between the others
  EXPECT_EQ(scene.warnings[0].substr(0, camera_file(1).size()), camera_file(1));
}

TEST_F(DamagedNpzScene, SingularIntrinsics) {
  write_camera(0, {0, 0, 10, 0, 16, 5, 0, 0, 1}, pose());
  EXPECT_EQ(error(), (images() / "frame_0.png").string() +
                         ": expected positive focal lengths, found fx 0 and fy 16; check the intrinsics.");
}

TEST_F(DamagedNpzScene, NormalisedIntrinsics) {
  write_camera(0, {0.8, 0, 0.5, 0, 1.6, 0.5, 0, 0, 1}, pose());
  EXPECT_EQ(error(), (images() / "frame_0.png").string() +
                         ": expected intrinsics in pixels, found fx 0.8, cx 0.5 for an image 20 pixels wide, "
                         "which look divided by the image size; "
                         "multiply fx and cx by the width, fy and cy by the height.");
}

TEST_F(DamagedNpzScene, MirroredAndScaledRotations) {
  auto mirrored = pose();
  mirrored[0] = -1;
  write_camera(0, {16, 0, 10, 0, 16, 5, 0, 0, 1}, mirrored);
  EXPECT_EQ(error(), camera_file(0) +
                         ": expected a pose with a rotation, found a mirroring (determinant -1); "
                         "check the axis convention.");
  auto scaled = pose();
  scaled[0] = 2;
  write_camera(0, {16, 0, 10, 0, 16, 5, 0, 0, 1}, scaled);
  EXPECT_EQ(error(),
            camera_file(0) +
                ": expected a pose with a rotation (axes of length 1), found axes stretched by 2 1 1; "
                "check the matrix.");
}

TEST_F(DamagedNpzScene, WrongShapesAndNames) {
  const std::vector<double> pose_values = pose();
  const std::vector<double> intrinsic{16, 0, 10, 0};
  write_npz(camera_file(2), {{"intrinsic", npy_from_doubles({2, 2}, intrinsic.data())},
                             {"pose", npy_from_doubles({4, 4}, pose_values.data())}});
  EXPECT_EQ(error(), camera_file(2) + ": expected intrinsic of shape (3, 3), found (2, 2); check the file.");
  write_npz(camera_file(2), {{"pose", npy_from_doubles({4, 4}, pose_values.data())}});
  EXPECT_EQ(error().substr(0, camera_file(2).size()), camera_file(2));
}

TEST_F(DamagedNpzScene, TruncatedCameraFileAndMissingImage) {
  const std::string bytes = read_file(camera_file(2));
  write_file_atomically(camera_file(2), bytes.substr(0, bytes.size() / 2));
  EXPECT_EQ(error().substr(0, camera_file(2).size() + 1), camera_file(2) + ":");
  std::filesystem::remove(camera_file(2));
  const Scene scene = open_scene(folder_.path());
  EXPECT_EQ(scene.frames.size(), 2U);
  EXPECT_EQ(scene.missing_files, 1);
  EXPECT_EQ(scene.warnings.back(), "1 of 3 listed files do not exist, the first is " + camera_file(2) + ".");
}

}  // namespace
}  // namespace gld
