// Layouts of recorded trajectories: RealEstate10K, TartanAir, HyperSim.
#include "datasets/formats/depth_files.h"
#include "datasets/formats/file_listing.h"
#include "datasets/formats/hdf5_file.h"
#include "datasets/formats/scene_layouts.h"
#include "datasets/images/image_file.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kMetresPerAssetUnit = 0.01;

// One camera for all frames, as TartanAir and HyperSim have it.
const Camera& shared_camera(const Scene& scene, const std::string& layout) {
  const Camera& first = scene.frames.front().camera;
  for (const Frame& frame : scene.frames) {
    if (frame.camera.width != first.width || frame.camera.height != first.height ||
        (frame.camera.intrinsics - first.intrinsics).cwiseAbs().maxCoeff() > 1e-9) {
      fail({layout + " layout", "one size and lens for all frames", "another one in " + frame.name,
            "choose another layout"});
    }
  }
  return first;
}

void check_tartanair_camera(const Camera& camera) {
  const double width = static_cast<double>(camera.width);
  const double height = static_cast<double>(camera.height);
  Eigen::Matrix3d expected = Eigen::Matrix3d::Identity();
  expected(0, 0) = expected(1, 1) = expected(0, 2) = 0.5 * width;
  expected(1, 2) = 0.5 * height;
  if (3 * camera.width == 4 * camera.height &&
      (camera.intrinsics - expected).cwiseAbs().maxCoeff() < 1e-6 * width) {
    return;
  }
  fail({"tartanair layout", "images of 4:3 with a field of view of 90 degrees",
        fmt::format("{}x{} with fx {:.6g}", camera.width, camera.height, camera.intrinsics(0, 0)),
        "set width, height, field_of_view_low and field_of_view_high so, or choose another layout"});
}

std::vector<float> linear_light(const Image& image) {
  std::vector<float> values;
  for (uint8_t value : image.rgb) values.push_back(static_cast<float>(std::pow(value / 255.0, 2.2)));
  return values;
}

// Planar depth to distance along the ray.
Hdf5Array ray_distances(const Frame& frame) {
  const DepthMap depth = frame.depth();
  const Eigen::Matrix3d ray_from_pixel = frame.camera.intrinsics.inverse();
  Hdf5Array array;
  array.shape = {depth.height, depth.width};
  for (int64_t y = 0; y < depth.height; ++y) {
    for (int64_t x = 0; x < depth.width; ++x) {
      const Eigen::Vector3d pixel(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1);
      array.values.push_back(static_cast<float>(depth.at(x, y) * (ray_from_pixel * pixel).norm()));
    }
  }
  return array;
}

std::string hypersim_table(const std::string& scene, const Camera& camera) {
  Eigen::Matrix3d pixel_from_uv;
  const double width = static_cast<double>(camera.width);
  const double height = static_cast<double>(camera.height);
  pixel_from_uv << 0.5 * width, 0, 0.5 * width, 0, -0.5 * height, 0.5 * height, 0, 0, 1;
  const Eigen::Matrix3d opengl_from_opencv = Eigen::Vector3d(1, -1, -1).asDiagonal();
  const Eigen::Matrix3d camera_from_uv = opengl_from_opencv * camera.intrinsics.inverse() * pixel_from_uv;
  std::string header =
      "scene_name,settings_output_img_height,settings_output_img_width,settings_units_info_meters_scale";
  std::string row = fmt::format("{},{:.1f},{:.1f},{}", scene, height, width, kMetresPerAssetUnit);
  for (int i = 0; i < 9; ++i) {
    header += fmt::format(",M_cam_from_uv_{}{}", i / 3, i % 3);
    row += fmt::format(",{}", camera_from_uv(i / 3, i % 3));
  }
  return header + "\n" + row + "\n";
}

}  // namespace

void write_re10k_layout(const Scene& scene, const std::filesystem::path& folder) {
  const auto images = folder / scene.name;
  std::filesystem::create_directories(images);
  std::string text = "https://example.org/" + scene.name + "\n";
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const Frame& frame = scene.frames[i];
    const Camera& camera = frame.camera;
    const auto width = static_cast<double>(camera.width);
    const auto height = static_cast<double>(camera.height);
    const int64_t time = 1'000'000 + 33'333 * static_cast<int64_t>(i);
    write_png(images / (std::to_string(time) + ".png"), frame.image());
    text += fmt::format("{} {} {} {} {} 0 0", time, camera.intrinsics(0, 0) / width,
                        camera.intrinsics(1, 1) / height, camera.intrinsics(0, 2) / width,
                        camera.intrinsics(1, 2) / height);
    const Eigen::Matrix4d pose = camera.camera_from_world().matrix();
    for (int k = 0; k < 12; ++k) text += fmt::format(" {}", pose(k / 4, k % 4));
    text += "\n";
  }
  write_file_atomically(folder / (scene.name + ".txt"), text);
}

void write_tartanair_layout(const Scene& scene, const std::filesystem::path& folder) {
  check_tartanair_camera(shared_camera(scene, "tartanair"));
  std::filesystem::create_directories(folder / "image_left");
  std::filesystem::create_directories(folder / "depth_left");
  Eigen::Matrix3d opencv_from_ned;  // right is east, down is down, forward is north
  opencv_from_ned << 0, 1, 0, 0, 0, 1, 1, 0, 0;
  std::string text;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const Frame& frame = scene.frames[i];
    const std::string name = fmt::format("{:06}_left", i);
    write_png(folder / "image_left" / (name + ".png"), frame.image());
    if (frame.has_depth()) write_depth_npy(folder / "depth_left" / (name + "_depth.npy"), frame.depth());
    const Eigen::Matrix3d ned = frame.camera.world_from_camera.linear() * opencv_from_ned;
    const Eigen::Quaterniond q(ned);
    const Eigen::Vector3d t = frame.camera.world_from_camera.translation();
    text += fmt::format("{} {} {} {} {} {} {}\n", t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
  }
  write_file_atomically(folder / "pose_left.txt", text);
}

void write_hypersim_layout(const Scene& scene, const std::filesystem::path& folder) {
  const Camera& camera = shared_camera(scene, "hypersim");
  const auto detail = folder / "_detail" / "cam_00";
  const auto colour = folder / "images" / "scene_cam_00_final_hdf5";
  const auto geometry = folder / "images" / "scene_cam_00_geometry_hdf5";
  for (const auto& path : {detail, colour, geometry}) std::filesystem::create_directories(path);
  Hdf5Array positions;
  Hdf5Array orientations;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const Frame& frame = scene.frames[i];
    Eigen::Matrix4d pose = frame.camera.world_from_camera.matrix();
    pose.col(1) *= -1;
    pose.col(2) *= -1;
    for (int k = 0; k < 3; ++k)
      positions.values.push_back(static_cast<float>(pose(k, 3) / kMetresPerAssetUnit));
    for (int k = 0; k < 9; ++k) orientations.values.push_back(static_cast<float>(pose(k / 3, k % 3)));
    const Image image = frame.image();
    write_hdf5(colour / fmt::format("frame.{:04}.color.hdf5", i), "dataset",
               {{image.height, image.width, 3}, linear_light(image)});
    if (frame.has_depth()) {
      write_hdf5(geometry / fmt::format("frame.{:04}.depth_meters.hdf5", i), "dataset", ray_distances(frame));
    }
  }
  const auto count = static_cast<int64_t>(scene.frames.size());
  positions.shape = {count, 3};
  orientations.shape = {count, 3, 3};
  write_hdf5(detail / "camera_keyframe_positions.hdf5", "dataset", positions);
  write_hdf5(detail / "camera_keyframe_orientations.hdf5", "dataset", orientations);
  write_file_atomically(folder / "metadata_camera_parameters.csv",
                        hypersim_table(folder_name(folder), camera));
}

}  // namespace gld
