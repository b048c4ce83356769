// Scans of ScanNet and lists of pairs of their frames, drawn rooms written as ScanNet's tools write them.
#include "datasets/formats/scannet_reader.h"

#include "datasets/images/image_file.h"
#include "datasets/images/png_file.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/files/npy.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;

std::string text_of(const Eigen::Matrix4d& matrix) {
  std::ostringstream text;
  text.precision(17);
  text << matrix << "\n";
  return text.str();
}

Scene drawn_room(int64_t frames) {
  SyntheticOptions options;
  options.frames = frames;
  options.width = 64;
  options.height = 48;
  return make_synthetic_scene(options, 0);
}

// Writes the frames under these numbers.
void write_scan(const Scene& scene, const std::filesystem::path& folder, const std::vector<int>& numbers) {
  for (const char* name : {"color", "depth", "pose", "intrinsic"})
    std::filesystem::create_directories(folder / name);
  for (size_t i = 0; i < numbers.size(); ++i) {
    const Frame& frame = scene.frames[i];
    const std::string number = std::to_string(numbers[i]);
    write_png(folder / "color" / (number + ".png"), frame.image());
    const DepthMap depth = frame.depth();
    Grey16 millimetres{depth.width, depth.height, {}};
    for (const float metres : depth.metres)
      millimetres.values.push_back(static_cast<uint16_t>(std::lround(metres * 1000)));
    write_file_atomically(folder / "depth" / (number + ".png"), encode_png(millimetres, {}));
    write_file_atomically(folder / "pose" / (number + ".txt"),
                          text_of(frame.camera.world_from_camera.matrix()));
  }
  Eigen::Matrix4d intrinsics = Eigen::Matrix4d::Identity();
  intrinsics.topLeftCorner<3, 3>() =
      Eigen::Vector3d(1296 / 64.0, 968 / 48.0, 1).asDiagonal() * scene.frames[0].camera.intrinsics;
  write_file_atomically(folder / "intrinsic" / "intrinsic_color.txt", text_of(intrinsics));
}

NpyArray npy_of(const std::vector<int64_t>& shape, const std::vector<double>& values) {
  return npy_from_doubles(shape, values.data());
}

TEST(Scannet, AScanHasItsCamerasPicturesAndDepth) {
  const TemporaryFolder folder;
  const Scene truth = drawn_room(3);
  write_scan(truth, folder.path(), {0, 2, 10});
  const Scene scene = open_scene(folder.path());
  EXPECT_EQ(scene.format, "scannet");
  EXPECT_TRUE(scene.metric);
  ASSERT_EQ(scene.frames.size(), 3U);
  for (size_t i = 0; i < 3; ++i) {
    const Camera &read = scene.frames[i].camera, &drawn = truth.frames[i].camera;
    EXPECT_EQ(read.width, 64);
    EXPECT_TRUE(read.intrinsics.isApprox(drawn.intrinsics, 1e-12)) << read.intrinsics;
    EXPECT_TRUE(read.world_from_camera.isApprox(drawn.world_from_camera, 1e-12));
    EXPECT_EQ(scene.frames[i].image().rgb, truth.frames[i].image().rgb);
    const DepthMap depth = scene.frames[i].depth(), exact = truth.frames[i].depth();
    ASSERT_EQ(depth.metres.size(), exact.metres.size());
    for (size_t k = 0; k < depth.metres.size(); ++k) EXPECT_NEAR(depth.metres[k], exact.metres[k], 0.00051);
  }
  EXPECT_EQ(scene.frames[2].name, "10") << "numbers in their order";
}

TEST(Scannet, FramesWhoseTrackingWasLostAreLeftOut) {
  const TemporaryFolder folder;
  write_scan(drawn_room(3), folder.path(), {0, 1, 2});
  write_file_atomically(
      folder.path() / "pose" / "1.txt",
      "-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n");
  const Scene scene = open_scene(folder.path());
  ASSERT_EQ(scene.frames.size(), 2U);
  EXPECT_EQ(scene.frames[1].name, "2");
  EXPECT_THAT(scene.warnings,
              testing::ElementsAre(
                  "1 of 3 frames have no pose, where ScanNet's tracking was lost, and are left out."));
}

TEST(Scannet, WhereAllTrackingWasLostOrAPairLacksAFrame) {
  const TemporaryFolder folder;
  const auto scan = folder.path() / "scene0707_00";
  write_scan(drawn_room(2), scan, {0, 1});
  const std::string lost =
      "-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n";
  write_file_atomically(scan / "pose" / "1.txt", lost);
  write_file_atomically(folder.path() / "scannet_test_pairs_with_gt.txt",
                        "scene0707_00_frame-000000.jpg scene0707_00_frame-000001.jpg 0 0\n");
  SceneReading reading;
  reading.part = "scene0707_00_0_1";
  EXPECT_EQ(
      error_of([&] { open_scene(folder.path(), reading); }),
      folder.path().string() +
          " pair scene0707_00_0_1: expected both of its frames, found one; leave the pair out of the list.");
  write_file_atomically(scan / "pose" / "0.txt", lost);
  EXPECT_EQ(
      error_of([&] { open_scene(scan); }),
      scan.string() +
          ": expected frames with a pose, found 2 without one, where ScanNet's tracking was lost; leave the scan "
          "out.");
}

TEST(Scannet, IntrinsicsSayWhichOfTwoSizesTheyBelongTo) {
  const TemporaryFolder folder;
  const Scene truth = drawn_room(1);
  write_scan(truth, folder.path(), {0});
  const auto file = folder.path() / "intrinsic" / "intrinsic_color.txt";
  Eigen::Matrix4d intrinsics = Eigen::Matrix4d::Identity();
  intrinsics.topLeftCorner<3, 3>() =
      Eigen::Vector3d(10, 10, 1).asDiagonal() * truth.frames[0].camera.intrinsics;
  write_file_atomically(file, text_of(intrinsics));
  EXPECT_TRUE(open_scene(folder.path())
                  .frames[0]
                  .camera.intrinsics.isApprox(truth.frames[0].camera.intrinsics, 1e-12));
  intrinsics.topLeftCorner<2, 3>() /= 2;
  write_file_atomically(file, text_of(intrinsics));
  EXPECT_EQ(
      error_of([&] { open_scene(folder.path()); }),
      file.string() +
          ": expected a principal point near the middle of 1296x968 or 640x480 pixels, found one at column 160; "
          "export the scan again in one of these sizes.");
}

// ScanNet's depth camera has half as many pixels as its other one: depth is brought to the picture's size.
TEST(Scannet, DepthOfAnotherSizeIsBroughtToThePictures) {
  const TemporaryFolder folder;
  write_scan(drawn_room(1), folder.path(), {0});
  Grey16 half{32, 24, std::vector<uint16_t>(32 * 24, 1500)};
  half.values[0] = 3000;
  write_file_atomically(folder.path() / "depth" / "0.png", encode_png(half, {}));
  const DepthMap depth = open_scene(folder.path()).frames[0].depth();
  EXPECT_EQ(depth.width, 64);
  EXPECT_EQ(depth.at(1, 1), 3.0F);
  EXPECT_EQ(depth.at(2, 2), 1.5F);
}

TEST(Scannet, PairsOfBothListsAreScenesOfTwoFrames) {
  const TemporaryFolder folder;
  const Scene truth = drawn_room(3);
  write_scan(truth, folder.path() / "scene0707_00", {15, 105, 585});
  write_scan(truth, folder.path() / "scene0708_01", {0, 30, 45});
  // Intrinsics as in the list's archive: for 640x480, beside the scans.
  for (const char* scan : {"scene0707_00", "scene0708_01"})
    std::filesystem::remove_all(folder.path() / scan / "intrinsic");
  std::vector<double> intrinsics;
  for (Eigen::Index row = 0; row < 3; ++row) {
    for (Eigen::Index column = 0; column < 3; ++column)
      intrinsics.push_back(truth.frames[0].camera.intrinsics(row, column) * (row < 2 ? 10 : 1));
  }
  write_npz(folder.path() / "intrinsics.npz",
            {{"scene0707_00", npy_of({3, 3}, intrinsics)}, {"scene0708_01", npy_of({3, 3}, intrinsics)}});
  const std::vector<std::string> expected{"scene0707_00_15_585", "scene0708_01_0_45"};
  for (const bool as_text : {false, true}) {
    std::filesystem::remove(folder.path() / "test.npz");
    if (as_text) {
      write_file_atomically(
          folder.path() / "scannet_test_pairs_with_gt.txt",
          "scene0707_00_frame-000015.jpg scene0707_00_frame-000585.jpg 0 0 1165.72 0. 649.095\n"
          "scene0708_01_frame-000000.jpg scene0708_01_frame-000045.jpg 0 0 1165.72 0. 649.095\n");
    } else {
      write_npz(folder.path() / "test.npz", {{"name", npy_of({2, 4}, {707, 0, 15, 585, 708, 1, 0, 45})}});
    }
    const auto found = list_scenes(folder.path());
    ASSERT_EQ(found.size(), 2U);
    for (size_t pair = 0; pair < 2; ++pair) {
      EXPECT_EQ(found[pair].part, expected[pair]);
      SceneReading reading;
      reading.part = found[pair].part;
      const Scene scene = open_scene(found[pair].path, reading);
      EXPECT_EQ(scene.name, expected[pair]);
      ASSERT_EQ(scene.frames.size(), 2U);
      EXPECT_TRUE(scene.frames[1].camera.intrinsics.isApprox(truth.frames[0].camera.intrinsics, 1e-12));
      EXPECT_TRUE(
          scene.frames[1].camera.world_from_camera.isApprox(truth.frames[2].camera.world_from_camera, 1e-12));
    }
    EXPECT_EQ(
        error_of([&] { open_scene(folder.path()); }),
        folder.path().string() +
            ": expected one of its 2 pairs, such as scene0707_00_15_585, found no choice; choose one with "
            "--part.");
  }
}

TEST(Scannet, DamagedScansAndLists) {
  const TemporaryFolder folder;
  const auto scan = folder.path() / "scene0707_00";
  write_scan(drawn_room(2), scan, {0, 1});
  const auto pose = scan / "pose" / "1.txt";
  const std::string good = read_file(pose);
  write_file_atomically(pose, "1 0 0 0\n0 1 0 0\n0 0 1 0\n");
  EXPECT_EQ(
      error_of([&] { open_scene(scan); }),
      pose.string() + ": expected a matrix of 4 rows of 4 numbers, found 12 numbers; export the scan again.");
  write_file_atomically(pose, good + "0 0 0 1\n");
  EXPECT_EQ(
      error_of([&] { open_scene(scan); }),
      pose.string() + ": expected a matrix of 4 rows of 4 numbers, found 20 numbers; export the scan again.");
  write_file_atomically(pose, good);
  SceneReading pairs;
  pairs.format = "scannet-pairs";
  EXPECT_EQ(
      error_of([&] { open_scene(folder.path(), pairs); }),
      folder.path().string() +
          ": expected test.npz or scannet_test_pairs_with_gt.txt, found neither; put the list beside the scans.");
  const auto list = folder.path() / "scannet_test_pairs_with_gt.txt";
  write_file_atomically(list, "scene0707_00_frame-000000.jpg scene0707_00/1.jpg 0 0\n");
  EXPECT_EQ(error_of([&] { list_scenes(folder.path()); }),
            list.string() +
                ":1: expected the names of two pictures, such as scene0707_00_frame-000015.jpg, found "
                "\"scene0707_00/1.jpg\"; copy the list again.");
  write_file_atomically(list, "scene0707_00_frame-000000.jpg scene0708_00_frame-000001.jpg 0 0\n");
  EXPECT_EQ(
      error_of([&] { list_scenes(folder.path()); }),
      list.string() +
          ":1: expected two pictures of one scan, found scene0707_00 and scene0708_00; copy the list again.");
  write_npz(folder.path() / "test.npz", {{"name", npy_of({1, 4}, {707, 0, 0, 1.5})}});
  EXPECT_EQ(error_of([&] { list_scenes(folder.path()); }),
            (folder.path() / "test.npz").string() +
                " row 0: expected whole numbers from 0, found 1.5; copy the file again.");
  std::filesystem::remove_all(scan / "intrinsic");
  EXPECT_EQ(error_of([&] { open_scene(scan); }),
            scan.string() +
                ": expected intrinsic/intrinsic_color.txt, or intrinsics.npz beside the scan, found "
                "neither; export the scan again.");
}

}  // namespace
}  // namespace gld
