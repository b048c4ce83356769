#include "tests/support/real_scenes.h"

#include "datasets/check/data_check.h"
#include "datasets/check/depth_warp.h"
#include "datasets/formats/colmap_model.h"
#include "datasets/formats/frame_pixels.h"
#include "datasets/formats/re10k_reader.h"
#include "datasets/formats/scene_reader.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <string>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <gtest/gtest.h>

namespace gld::test {

void expect_re10k_text_equals_npz(const std::filesystem::path& scenes) {
  const auto rows = read_re10k_rows(scenes / "re10k" / "5e040cd0758dcc96.txt");
  ASSERT_GE(rows.size(), 8U);  // the clip's 153 rows, or those of its 8 frames
  const Scene clip = open_scene(scenes / "gld_layout_5e040cd0758dcc96");

  // The reader proper reads the clip's images under the names that the text file gives them.
  const TemporaryFolder folder;
  std::filesystem::create_directories(folder.path() / "5e040cd0758dcc96");
  std::filesystem::copy_file(scenes / "re10k" / "5e040cd0758dcc96.txt",
                             folder.path() / "5e040cd0758dcc96.txt");
  for (size_t k = 0; k < 8; ++k) {
    const auto row = static_cast<size_t>(std::floor(static_cast<double>((rows.size() - 1) * k) / 7.0));
    std::filesystem::copy_file(clip.frames[k].image_file, folder.path() / "5e040cd0758dcc96" /
                                                              (std::to_string(rows[row].time) + ".png"));
  }
  const Scene read = open_scene(folder.path());
  EXPECT_EQ(read.format, "re10k");
  EXPECT_EQ(read.missing_files, static_cast<int64_t>(rows.size()) - 8);
  ASSERT_EQ(read.frames.size(), 8U);
  for (size_t k = 0; k < 8; ++k) {
    const Camera& text = read.frames[k].camera;
    const Camera& npz = clip.frames[k].camera;
    EXPECT_LT((text.world_from_camera.matrix() - npz.world_from_camera.matrix()).cwiseAbs().maxCoeff(), 1e-6)
        << k;
    EXPECT_LT((text.intrinsics - npz.intrinsics).cwiseAbs().maxCoeff(), 1e-4) << k;
    EXPECT_EQ(text.width, 504);
  }
}

void expect_tartanair_depth_agrees(const std::filesystem::path& path, size_t frames) {
  const Scene scene = open_scene(path);
  EXPECT_EQ(scene.format, "tartanair");
  EXPECT_TRUE(scene.metric);
  ASSERT_EQ(scene.frames.size(), frames);
  EXPECT_EQ(scene.frames[1].name, "000043_left");
  for (size_t i = 0; i + 1 < scene.frames.size(); i += 3) {
    const Frame& a = scene.frames[i];
    const Frame& b = scene.frames[i + 1];
    const WarpResult warp = warp_depth({a.camera, a.depth()}, {b.camera, b.depth()}, 0.02);
    EXPECT_GT(warp.share_in_view, 0.6) << i;
    EXPECT_GT(warp.share_agreeing, 0.9) << i;
    EXPECT_LT(warp.median_error, 0.002) << i;
    // A wrong convention must not pass: this is the same test with the camera's y and z turned around.
    Camera wrong_a = a.camera;
    Camera wrong_b = b.camera;
    for (Camera* camera : {&wrong_a, &wrong_b}) camera->world_from_camera.linear().rightCols<2>() *= -1;
    EXPECT_LT(warp_depth({wrong_a, a.depth()}, {wrong_b, b.depth()}, 0.02).share_agreeing, 0.6) << i;
  }
}

void expect_colmap_text_equals_binary(const std::filesystem::path& scenes, const ColmapCounts& counts) {
  const ColmapModel text = read_colmap_model(scenes / "colmap_lund_door" / "sparse" / "0", ColmapForm::kText);
  const ColmapModel binary =
      read_colmap_model(scenes / "colmap_lund_door_binary" / "sparse" / "0", ColmapForm::kBinary);
  ASSERT_EQ(text.images.size(), counts.images);
  ASSERT_EQ(binary.images.size(), counts.images);
  ASSERT_EQ(text.points_in_world.size(), counts.points);
  EXPECT_EQ(text.points_in_world, binary.points_in_world);
  ASSERT_EQ(text.cameras.size(), binary.cameras.size());
  for (const auto& [id, camera] : text.cameras) {
    const ColmapCamera& other = binary.cameras.at(id);
    EXPECT_EQ(camera.model, other.model);
    EXPECT_EQ(camera.width, other.width);
    EXPECT_EQ(camera.height, other.height);
    EXPECT_EQ(camera.parameters, other.parameters);
  }
  for (size_t i = 0; i < counts.images; ++i) {
    EXPECT_EQ(text.images[i].name, binary.images[i].name);
    EXPECT_EQ(text.images[i].translation, binary.images[i].translation);
    // The text has quaternions of length 1 +- 1e-6, the binary file those of length 1.
    const FrameRecord a = colmap_record(text, text.images[i], "a.jpg", "text");
    const FrameRecord b = colmap_record(binary, binary.images[i], "a.jpg", "binary");
    EXPECT_LT((a.world_from_camera.matrix() - b.world_from_camera.matrix()).cwiseAbs().maxCoeff(), 1e-13);
  }
}

Scene expect_colmap_points_inside(const std::filesystem::path& path, const ColmapCounts& counts,
                                  int64_t fewest_inside) {
  Scene scene = open_scene(path);
  EXPECT_EQ(scene.format, "colmap");
  EXPECT_EQ(scene.frames.size(), counts.images);
  EXPECT_EQ(scene.points_in_world.size(), counts.points);
  for (const Frame& frame : scene.frames) {
    const Camera& camera = frame.camera;
    EXPECT_DOUBLE_EQ(static_cast<double>(camera.width) / static_cast<double>(camera.height), 1296.0 / 1936);
    const Eigen::Isometry3d camera_from_world = camera.camera_from_world();
    int64_t inside = 0;
    for (const Eigen::Vector3d& point : scene.points_in_world) {
      const Eigen::Vector3d in_camera = camera_from_world * point;
      const Eigen::Vector2d pixel = (camera.intrinsics * in_camera).hnormalized();
      inside += in_camera.z() > 0 && pixel.x() > 0 && pixel.y() > 0 &&
                        pixel.x() < static_cast<double>(camera.width) &&
                        pixel.y() < static_cast<double>(camera.height)
                    ? 1
                    : 0;
    }
    EXPECT_GE(inside, fewest_inside) << frame.name;
  }
  // The middle of an undistorted picture shows the scene.
  const ValidityMask mask = scene.frames.at(0).validity();
  EXPECT_EQ(mask.valid.at(static_cast<size_t>(mask.height / 2 * mask.width + mask.width / 2)), 1);
  return scene;
}

void expect_no_mistakes(const std::filesystem::path& scenes) {
  for (const char* name : {"gld_layout_5e040cd0758dcc96", "tartanair_hospital", "colmap_lund_door"}) {
    DataCheckOptions options;
    options.most_images = 1;
    options.most_pairs = 2;
    const DataCheck check = check_scene(SceneLocation{scenes / name, ""}, options);
    EXPECT_TRUE(check.problems.empty()) << name << ": " << check.problems.front();
    ASSERT_EQ(check.poses.evidence.size(), 4U) << name;
    EXPECT_GT(check.poses.evidence[0].agreement, 0.5) << name;
  }
}

}  // namespace gld::test
