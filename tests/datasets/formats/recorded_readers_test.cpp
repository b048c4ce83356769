// The readers of RealEstate10K, TartanAir and HyperSim on real files with known truth, and on damaged ones.
#include "datasets/formats/hypersim_camera.h"
#include "datasets/formats/hypersim_reader.h"
#include "datasets/formats/re10k_reader.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/files/hdf5_array.h"
#include "gld/files/npy.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/hypersim_scene.h"
#include "tests/support/real_scenes.h"
#include "tests/support/temporary_folder.h"

#include <cmath>

#include <Eigen/LU>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;
using test::test_data;

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t position = text.find(from);
  if (position == std::string::npos) throw std::runtime_error("test: nothing to replace");
  return text.replace(position, from.size(), to);
}

TEST(Re10k, TheTextFileEqualsTheNpzPosesOfTheSameClip) {
  test::expect_re10k_text_equals_npz(test_data() / "scenes");
}

TEST(Re10k, DamagedFiles) {
  const TemporaryFolder folder;
  SyntheticOptions options;
  options.frames = 3;
  options.width = options.height = 16;
  Scene scene = make_synthetic_scene(options, 0);
  scene.name = "clip";
  write_scene(scene, "re10k", folder.path());
  const auto file = folder.path() / "clip.txt";
  const std::string good = read_file(file);
  write_file_atomically(file, good + "1 2 3\n");
  EXPECT_EQ(error_of([&] { open_scene(folder.path()); }),
            file.string() + ":5: expected 19 fields, found 3; correct the file.");
  const std::string start = good.substr(0, good.find('\n') + 1) + "1000000 0.9 0.9 0.5 0.5 0 0 ";
  write_file_atomically(file, start + "nan 0 0 0 0 1 0 0 0 0 1 0\n");
  EXPECT_EQ(
      error_of([&] { open_scene(folder.path()); }),
      file.string() +
          ":2: expected a finite pose, found a value that is not a number or infinite; leave the frame out.");
  write_file_atomically(file, start + "x 0 0 0 0 1 0 0 0 0 1 0\n");
  EXPECT_EQ(error_of([&] { open_scene(folder.path()); }),
            file.string() + ":2: expected a number, found \"x\"; correct the file.");
  write_file_atomically(file, good);
  std::filesystem::remove_all(folder.path() / "clip");
  EXPECT_EQ(error_of([&] { open_scene(folder.path()); }),
            file.string() +
                ": expected the clip's frames in clip/, frames/clip/ or images/clip/, found none; "
                "extract them from the video, named by their times in microseconds.");
}

TEST(TartanAir, WarpingDepthBetweenViewsAgrees) {
  test::expect_tartanair_depth_agrees(test_data() / "scenes" / "tartanair_hospital", 2);
}

TEST(TartanAir, DamagedScenes) {
  const TemporaryFolder folder;
  SyntheticOptions options;
  options.frames = 3;
  options.width = 32;
  options.height = 24;
  options.field_of_view_low = options.field_of_view_high = 90;
  write_scene(make_synthetic_scene(options, 0), "tartanair", folder.path());
  const auto poses = folder.path() / "pose_left.txt";
  const std::string good = read_file(poses);
  write_file_atomically(poses, good + good.substr(0, good.find('\n') + 1));
  EXPECT_EQ(
      error_of([&] { open_scene(folder.path()); }),
      poses.string() + ": expected one row for each of the 3 images, found 4 rows; copy the scene again.");
  write_file_atomically(poses, "0 0 0 0 0 0 1\n0 0 0 0 0 0 1\n0 0 0 0 0 0 0\n");
  EXPECT_EQ(
      error_of([&] { open_scene(folder.path()); }),
      poses.string() +
          ":3: expected a quaternion of length 1, found one of length 0; check the order of the columns.");
  write_file_atomically(poses, good);
  const auto depth = folder.path() / "depth_left" / "000001_left_depth.npy";
  const std::string bytes = read_file(depth);
  write_file_atomically(depth, bytes.substr(0, bytes.size() - 7));
  const Scene scene = open_scene(folder.path());
  EXPECT_EQ(error_of([&] { scene.frames[1].depth(); }).substr(0, depth.string().size() + 10),
            depth.string() + ": expected");
  const std::vector<float> flat(5, 1.0F);
  write_npy(depth, npy_from_floats({5}, flat.data()));
  EXPECT_EQ(error_of([&] { scene.frames[1].depth(); }),
            depth.string() +
                ": expected depth as (height, width) of floating type, found float32 (5); check the file.");
}

TEST(Hypersim, RealMetadataGiveTheirConventions) {
  const auto scene = test_data() / "scenes" / "hypersim_pieces" / "ai_037_002";
  const HypersimSettings settings = read_hypersim_settings(scene);
  EXPECT_EQ(settings.width, 1024);
  EXPECT_EQ(settings.height, 768);
  EXPECT_NEAR(settings.metres_per_asset_unit, 0.01, 1e-9);
  EXPECT_NEAR(settings.camera_from_uv(1, 2), 0.0927331, 1e-6);

  // The tilted lens as a turned pinhole camera: every stored ray must be met by the ideal one.
  const HypersimLens lens(settings, "test");
  EXPECT_NEAR(lens.stored_from_camera().determinant(), 1, 1e-12);
  for (double u : {-0.9, 0.0, 0.7}) {
    for (double v : {-0.8, 0.1, 0.9}) {
      Eigen::Vector3d ray = settings.camera_from_uv * Eigen::Vector3d(u, v, 1);
      ray = Eigen::Vector3d(ray.x(), -ray.y(), -ray.z()).normalized();
      const Eigen::Vector3d seen = lens.camera().intrinsics * lens.stored_from_camera().transpose() * ray;
      const Eigen::Vector2d pixel = seen.hnormalized();
      EXPECT_NEAR(pixel.x(), (u + 1) * 512, std::abs(lens.skew()) + 1e-6);
      EXPECT_NEAR(pixel.y(), (1 - v) * 384, 1e-6);
    }
  }
}

TEST(Hypersim, RealTrajectoryAndDepth) {
  const auto path = test_data() / "scenes" / "hypersim_pieces" / "ai_037_002";
  const auto poses = read_hypersim_trajectory(path / "_detail" / "cam_00", 0.01);
  ASSERT_EQ(poses.size(), 100U);
  for (const auto& [frame, pose] : poses) {
    EXPECT_NEAR((pose.topLeftCorner<3, 3>().determinant()), 1, 1e-4) << frame;
    EXPECT_LT((pose.topRightCorner<3, 1>().norm()), 100) << frame;
  }
  const Scene scene = open_scene(path);
  EXPECT_EQ(scene.format, "hypersim");
  EXPECT_EQ(scene.missing_files, 99);
  ASSERT_EQ(scene.frames.size(), 1U);
  EXPECT_FALSE(scene.frames[0].has_image());

  // Planar depth is the distance along the ray times the cosine of its angle to the axis.
  const Hdf5Array stored = read_hdf5_array(
      path / "images" / "scene_cam_00_geometry_hdf5" / "frame.0000.depth_meters.hdf5", "dataset", 768 * 1024);
  ASSERT_EQ(stored.shape, (std::vector<int64_t>{768, 1024}));
  const DepthMap depth = scene.frames[0].depth();
  const Camera& camera = scene.frames[0].camera;
  for (const auto& [x, y] : {std::pair<int64_t, int64_t>{512, 384}, {40, 30}, {1000, 700}}) {
    const float distance = stored.values[static_cast<size_t>(y * 1024 + x)];
    if (!std::isfinite(distance)) continue;
    const Eigen::Vector3d ray =
        camera.intrinsics.inverse() *
        Eigen::Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1);
    EXPECT_NEAR(depth.at(x, y), distance / ray.norm(), 2e-3 * distance);
  }
  // The floor or walls of a room: neighbouring depths change smoothly, and all are metres of a room.
  EXPECT_GT(depth.at(512, 600), 0.2);
  EXPECT_LT(depth.at(512, 600), 30);
}

TEST(Hypersim, ScenesWithoutPhysicalCameraSeeSixtyDegrees) {
  const TemporaryFolder folder;
  std::filesystem::create_directories(folder.path() / "_detail");
  write_file_atomically(folder.path() / "_detail" / "metadata_scene.csv",
                        "parameter_name,parameter_value\nmeters_per_asset_unit,0.0254\n");
  const HypersimSettings settings = read_hypersim_settings(folder.path());
  EXPECT_EQ(settings.metres_per_asset_unit, 0.0254);
  const HypersimLens lens(settings, "test");
  EXPECT_NEAR(lens.camera().intrinsics(0, 0), 886.81, 0.01);
  EXPECT_NEAR(lens.camera().intrinsics(1, 1), 886.81, 0.01);
  EXPECT_NEAR(lens.camera().intrinsics(0, 2), 512, 1e-9);
  EXPECT_NEAR(lens.camera().intrinsics(1, 2), 384, 1e-9);
  std::filesystem::remove_all(folder.path() / "_detail");
  EXPECT_EQ(error_of([&] { read_hypersim_settings(folder.path()); }),
            folder.path().string() +
                ": expected the scene's scale in _detail/metadata_scene.csv or "
                "metadata_camera_parameters.csv, found none; download one of these files.");
}

TEST(Hypersim, DamagedFiles) {
  const TemporaryFolder folder;
  SyntheticOptions options;
  options.frames = 3;
  options.width = options.height = 24;
  const auto path = folder.path() / "ai_001_001";
  test::write_hypersim_scene(make_synthetic_scene(options, 0), path);
  const auto colour = path / "images" / "scene_cam_00_final_hdf5" / "frame.0001.color.hdf5";
  const std::string bytes = read_file(colour);
  const Scene scene = open_scene(path);
  for (size_t size : {size_t{0}, size_t{7}, size_t{200}, bytes.size() / 2, bytes.size() - 5}) {
    write_file_atomically(colour, bytes.substr(0, size));
    EXPECT_EQ(error_of([&] { scene.frames[1].image(); }),
              colour.string() +
                  ": expected an HDF5 file, found a damaged or truncated one, or another kind of file; "
                  "copy or download it again.");
  }
  test::write_hdf5(colour, "other", {{2}, {1, 2}});
  EXPECT_EQ(error_of([&] { scene.frames[1].image(); }),
            colour.string() +
                ": expected the dataset \"dataset\", found none; check that it is a file of this kind.");
  const auto positions = path / "_detail" / "cam_00" / "camera_keyframe_positions.hdf5";
  test::write_hdf5(positions, "dataset", {{2, 3}, {0, 0, 0, 1, 1, 1}});
  EXPECT_EQ(error_of([&] { open_scene(path); }),
            (path / "_detail" / "cam_00" / "camera_keyframe_orientations.hdf5").string() +
                ": expected shape (2, 3, 3), found (3, 3, 3); check that the files belong together.");
  test::write_hdf5(positions, "dataset", {{3, 3}, {0, 0, 0, NAN, 1, 1, 2, 2, 2}});
  EXPECT_EQ(error_of([&] { open_scene(path); }),
            (path / "_detail" / "cam_00").string() +
                " frame 1: expected a finite pose, found a value that is not a number or infinite; "
                "leave the frame out.");
  SceneReading skip;
  skip.broken_frames = BrokenFrames::kSkip;
  EXPECT_EQ(open_scene(path, skip).broken_frames, 1);
  const auto table = path / "metadata_camera_parameters.csv";
  write_file_atomically(table, replaced(read_file(table), "M_cam_from_uv_00", "M_other"));
  EXPECT_EQ(error_of([&] { open_scene(path); }),
            path.string() +
                " metadata_camera_parameters.csv: expected the column M_cam_from_uv_00, found none; "
                "download the table again.");
}

TEST(Hypersim, SeveralCamerasAreSeveralScenes) {
  const TemporaryFolder folder;
  SyntheticOptions options;
  options.frames = 2;
  options.width = options.height = 24;
  const auto path = folder.path() / "ai_001_001";
  test::write_hypersim_scene(make_synthetic_scene(options, 0), path);
  std::filesystem::copy(path / "_detail" / "cam_00", path / "_detail" / "cam_01");
  const auto scenes = list_scenes(folder.path());
  ASSERT_EQ(scenes.size(), 2U);
  EXPECT_EQ(scenes[1].part, "cam_01");
  EXPECT_EQ(error_of([&] { open_scene(path); }),
            path.string() +
                ": expected one of the cameras cam_00, cam_01, found no choice; choose one with --part.");
}

}  // namespace
}  // namespace gld
