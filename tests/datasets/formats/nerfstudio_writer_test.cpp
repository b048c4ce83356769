#include "datasets/formats/nerfstudio_writer.h"

#include "datasets/formats/json_file.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/images/image_file.h"
#include "tests/support/temporary_folder.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::TemporaryFolder;

Transforms one_view() {
  TransformsFrame frame;
  frame.image = "images/a.png";
  frame.camera.width = 8;
  frame.camera.height = 6;
  frame.camera.intrinsics << 7, 0, 3, 0, 9, 2.5, 0, 0, 1;
  frame.camera.world_from_camera.linear() =
      Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  frame.camera.world_from_camera.translation() = Eigen::Vector3d(1, -2, 0.1);
  Transforms transforms;
  transforms.frames = {frame};
  return transforms;
}

TEST(NerfstudioWriter, NamesCloudAndUnit) {
  const TemporaryFolder folder;
  Transforms transforms = one_view();
  transforms.depth_unit = 0.002;
  transforms.point_cloud = "points.ply";
  transforms.comments = {{"gld:seed", "7"}};
  write_transforms_json(folder.path() / "transforms.json", transforms);
  const auto json = read_json_file(folder.path() / "transforms.json");
  EXPECT_EQ(json.at("ply_file_path"), "points.ply");
  EXPECT_EQ(json.at("depth_unit_scale_factor"), 0.002);
  EXPECT_EQ(json.at("camera_model"), "OPENCV");
  EXPECT_EQ(json.at("gld").at("gld:seed"), "7");
  EXPECT_EQ(json.at("frames").size(), 1U);
  EXPECT_FALSE(json.at("frames")[0].contains("depth_file_path"));
  // OpenGL's axes: y and z turn around, the place stays.
  const Eigen::Matrix4d written = json_pose(json.at("frames")[0].at("transform_matrix"), "test");
  const Eigen::Matrix4d pose = transforms.frames[0].camera.world_from_camera.matrix();
  EXPECT_EQ(written.col(0), pose.col(0));
  EXPECT_EQ(written.col(1), -pose.col(1));
  EXPECT_EQ(written.col(2), -pose.col(2));
  EXPECT_EQ(written.col(3), pose.col(3));
}

TEST(NerfstudioWriter, LeavesOutWhatThereIsNot) {
  const TemporaryFolder folder;
  write_transforms_json(folder.path() / "transforms.json", one_view());
  const auto json = read_json_file(folder.path() / "transforms.json");
  for (const char* key : {"ply_file_path", "depth_unit_scale_factor", "gld"})
    EXPECT_FALSE(json.contains(key)) << key;
}

TEST(NerfstudioWriter, IsReadBack) {
  const TemporaryFolder folder;
  std::filesystem::create_directories(folder.path() / "images");
  write_png(folder.path() / "images" / "a.png", Image(8, 6));
  const Transforms transforms = one_view();
  write_transforms_json(folder.path() / "transforms.json", transforms);
  const Scene scene = open_scene(folder.path());
  ASSERT_EQ(scene.frames.size(), 1U);
  const Camera& expected = transforms.frames[0].camera;
  EXPECT_EQ(scene.frames[0].camera.intrinsics, expected.intrinsics);
  EXPECT_LT((scene.frames[0].camera.world_from_camera.matrix() - expected.world_from_camera.matrix())
                .cwiseAbs()
                .maxCoeff(),
            1e-14);
}

}  // namespace
}  // namespace gld
