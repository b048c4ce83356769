// Every layout is written from a generated scene and read back: what the reader finds must be what was written.
#include "datasets/formats/hypersim_reader.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "tests/support/error_of.h"
#include "tests/support/hypersim_scene.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <cstdlib>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;

Scene written_scene() {
  SyntheticOptions options;
  options.frames = 12;  // more than ten, so that an alphabetical order would show
  options.width = 64;
  options.height = 48;
  options.field_of_view_low = 90;
  options.field_of_view_high = 90;
  Scene scene = make_synthetic_scene(options, 0);
  for (size_t i = 0; i < scene.frames.size(); ++i) scene.frames[i].name = "frame_" + std::to_string(i);
  scene.points_in_world = {{1, 2, 3}, {0.5, -0.25, 0.125}};
  return scene;
}

double largest_difference(const DepthMap& a, const DepthMap& b) {
  if (a.metres.size() != b.metres.size()) return 1e9;
  double largest = 0;
  for (size_t i = 0; i < a.metres.size(); ++i) {
    const double difference = std::abs(static_cast<double>(a.metres[i]) - static_cast<double>(b.metres[i]));
    if (std::isnan(difference)) return 1e9;  // std::max would drop it
    largest = std::max(largest, difference);
  }
  return largest;
}

double mean_difference(const Image& a, const Image& b) {
  if (a.rgb.size() != b.rgb.size()) return 1e9;
  double sum = 0;
  for (size_t i = 0; i < a.rgb.size(); ++i) sum += std::abs(a.rgb[i] - b.rgb[i]);
  return sum / static_cast<double>(a.rgb.size());
}

struct LayoutCase {
  const char* layout;
  const char* format;
  bool depth;
  double pose_tolerance;
  double image_tolerance;  // mean difference, of 255
};

void PrintTo(const LayoutCase& layout, std::ostream* stream) { *stream << layout.layout; }

class RoundTrip : public ::testing::TestWithParam<LayoutCase> {};

TEST_P(RoundTrip, ReadsWhatWasWritten) {
  const TemporaryFolder folder;
  const auto path = folder.path() / "scene";
  const Scene original = written_scene();
  write_scene(original, GetParam().layout, path);
  const Scene read = open_scene(path);
  EXPECT_EQ(read.format, GetParam().format);
  EXPECT_EQ(read.missing_files, 0);
  EXPECT_EQ(read.broken_frames, 0);
  EXPECT_TRUE(read.warnings.empty());
  ASSERT_EQ(read.frames.size(), original.frames.size());
  for (size_t i = 0; i < read.frames.size(); ++i) {
    const Frame& expected = original.frames[i];
    const Frame& found = read.frames[i];
    EXPECT_EQ(found.camera.width, 64);
    EXPECT_EQ(found.camera.height, 48);
    EXPECT_LT((found.camera.intrinsics - expected.camera.intrinsics).cwiseAbs().maxCoeff(), 1e-6) << i;
    EXPECT_LE((found.camera.world_from_camera.matrix() - expected.camera.world_from_camera.matrix())
                  .cwiseAbs()
                  .maxCoeff(),
              GetParam().pose_tolerance)
        << i;
    EXPECT_EQ(found.has_depth(), GetParam().depth);
  }
  for (size_t i : {0U, 11U}) {
    EXPECT_LE(mean_difference(read.frames[i].image(), original.frames[i].image()),
              GetParam().image_tolerance);
    if (GetParam().depth) {
      EXPECT_LT(largest_difference(read.frames[i].depth(), original.frames[i].depth()), 1e-5);
    }
  }
  const auto scenes = list_scenes(folder.path());
  ASSERT_EQ(scenes.size(), 1U);
}

INSTANTIATE_TEST_SUITE_P(Layouts, RoundTrip,
                         ::testing::Values(LayoutCase{"cameras-json", "cameras-json", true, 0, 0},
                                           LayoutCase{"npz", "npz", false, 0, 0},
                                           LayoutCase{"nerfstudio", "nerfstudio", true, 0, 0},
                                           LayoutCase{"re10k", "re10k", false, 1e-12, 0},
                                           LayoutCase{"tartanair", "tartanair", true, 1e-12, 0},
                                           LayoutCase{"colmap", "colmap", false, 1e-12, 0},
                                           LayoutCase{"colmap-text", "colmap", false, 1e-12, 0},
                                           LayoutCase{"eth3d", "eth3d", true, 1e-12, 6}));

// HyperSim stores float32 poses and linear light, which its tone mapping brightens or darkens as a whole.
TEST(RoundTripHypersim, ReadsWhatWasWritten) {
  const TemporaryFolder folder;
  const Scene original = written_scene();
  test::write_hypersim_scene(original, folder.path() / "ai_999_001");
  const Scene read = open_scene(folder.path() / "ai_999_001");
  EXPECT_EQ(read.format, "hypersim");
  EXPECT_TRUE(read.metric);
  ASSERT_EQ(read.frames.size(), 12U);
  for (size_t i = 0; i < read.frames.size(); ++i) {
    const Camera& expected = original.frames[i].camera;
    const Camera& found = read.frames[i].camera;
    EXPECT_LT((found.intrinsics - expected.intrinsics).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_LT((found.world_from_camera.matrix() - expected.world_from_camera.matrix()).cwiseAbs().maxCoeff(),
              1e-6);
  }
  EXPECT_LT(largest_difference(read.frames[3].depth(), original.frames[3].depth()), 1e-5);
  const Image image = original.frames[3].image();
  std::vector<float> linear;
  for (uint8_t value : image.rgb) linear.push_back(static_cast<float>(std::pow(value / 255.0, 2.2)));
  EXPECT_EQ(read.frames[3].image().rgb, tone_mapped(linear, 64, 48).rgb);
}

TEST(RoundTrip, ColmapKeepsPoints) {
  const TemporaryFolder folder;
  for (const char* layout : {"colmap", "colmap-text"}) {
    const auto path = folder.path() / layout;
    write_scene(written_scene(), layout, path);
    EXPECT_EQ(open_scene(path).points_in_world, written_scene().points_in_world);
  }
}

// A layout without a list of frames would be a valid, shorter scene.
TEST(SceneWriter, HalfASceneIsNoScene) {
  const TemporaryFolder folder;
  for (const std::string& layout : scene_layout_names()) {
    SyntheticOptions options;
    options.frames = 4;
    options.width = 64;
    options.height = 48;
    options.field_of_view_low = options.field_of_view_high = 90;
    Scene scene = make_synthetic_scene(options, 0);
    int64_t left = 2;
    for (Frame& frame : scene.frames) {
      frame.load_image = [&left, load = frame.load_image] {
        if (left-- == 0) throw std::runtime_error("killed");
        return load();
      };
    }
    const auto path = folder.path() / layout;
    EXPECT_THROW(write_scene(scene, layout, path), std::runtime_error) << layout;
    EXPECT_FALSE(std::filesystem::exists(path)) << layout;
    EXPECT_TRUE(std::filesystem::is_empty(folder.path())) << layout;
  }
}

TEST(SceneWriter, RefusesWhatALayoutCannotHold) {
  const TemporaryFolder folder;
  SyntheticOptions options;
  options.frames = 2;
  options.width = 32;
  options.height = 32;
  options.field_of_view_low = 90;
  options.field_of_view_high = 90;
  EXPECT_EQ(error_of([&] { write_scene(make_synthetic_scene(options, 0), "tartanair", folder.path()); }),
            "tartanair layout: expected images of 4:3 with a field of view of 90 degrees, "
            "found 32x32 with fx 16; set width, height, field_of_view_low and field_of_view_high so, "
            "or choose another layout.");
  EXPECT_EQ(error_of([&] { write_scene(make_synthetic_scene(options, 0), "colmab", folder.path()); }),
            "layout: expected a layout that can be written, found \"colmab\"; did you mean \"colmap\"?");
}

TEST(SceneReader, SaysHowPhotographsWithoutCamerasGetSome) {
  const TemporaryFolder folder;
  write_png(folder.path() / "a.png", Image(4, 4));
  write_png(folder.path() / "b.png", Image(4, 4));
  const std::string sentence = error_of([&] { open_scene(folder.path()); });
  EXPECT_THAT(sentence,
              testing::HasSubstr("found 2 photographs without cameras; let the model estimate them with gld "
                                 "sample --photos " +
                                 folder.path().string() + ", or let COLMAP: colmap "));
}

TEST(SceneReader, NamesTheFormatsWhenNoneIsRecognised) {
  const TemporaryFolder folder;
  const std::string path = folder.path().string();
  EXPECT_EQ(error_of([&] { open_scene(folder.path()); }),
            path +
                ": expected one of: cameras.json (cameras-json), "
                "images_N/ with a .npz beside each image (npz), "
                "transforms.json with frames (nerfstudio), "
                "_detail/cam_XX/camera_keyframe_positions.hdf5 (hypersim), pose_left.txt (tartanair), "
                "dslr_calibration_jpg/ or dslr_calibration_undistorted/ (eth3d), "
                "sparse/0 with cameras.bin or cameras.txt (colmap), "
                "scans of ScanNet with test.npz or scannet_test_pairs_with_gt.txt (scannet-pairs), "
                "color and pose, with numbered files (scannet), "
                "a camera text file that starts with a video's address (re10k), found none of them; "
                "check the folder; gld check-data --format forces a layout and says what is missing.");
  EXPECT_EQ(error_of([&] { open_scene(folder.path() / "nowhere"); }),
            path + "/nowhere: expected a scene's folder, found nothing; check the path.");
  SceneReading reading;
  reading.format = "colmop";
  EXPECT_EQ(
      error_of([&] { reading.check(); }),
      "--format: expected auto or cameras-json, npz, nerfstudio, hypersim, tartanair, eth3d, colmap, scannet-pairs, "
      "scannet, re10k, "
      "found \"colmop\"; did you mean \"colmap\"?");
}

TEST(SceneReader, AFolderOfScenesIsNotAScene) {
  const TemporaryFolder folder;
  Scene scene = written_scene();
  scene.frames.resize(2);
  write_scene(scene, "cameras-json", folder.path() / "a");
  write_scene(scene, "colmap", folder.path() / "deeper" / "b");
  EXPECT_EQ(error_of([&] { open_scene(folder.path()); }),
            folder.path().string() +
                ": expected one scene, found a folder of 2 scenes; name one of them, such as " +
                (folder.path() / "a").string() + ".");
  const auto scenes = list_scenes(folder.path());
  ASSERT_EQ(scenes.size(), 2U);
  EXPECT_EQ(scenes[1].path, folder.path() / "deeper" / "b");
  SceneReading reading;
  reading.format = "colmap";
  EXPECT_EQ(list_scenes(folder.path(), reading).size(), 1U);
}

}  // namespace
}  // namespace gld
