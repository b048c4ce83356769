#include "tests/support/hypersim_scene.h"

#include "datasets/images/image.h"
#include "gld/base/atomic_file.h"

#include <cmath>
#include <vector>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <hdf5.h>

namespace gld::test {
namespace {

constexpr double kMetresPerAssetUnit = 0.01;

std::vector<float> linear_light(const Image& image) {
  std::vector<float> values;
  for (uint8_t value : image.rgb) values.push_back(static_cast<float>(std::pow(value / 255.0, 2.2)));
  return values;
}

// Turns planar depth to distance along the ray.
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

void write_hdf5(const std::filesystem::path& file, const std::string& dataset, const Hdf5Array& array) {
  const hid_t handle = H5Fcreate(file.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  const std::vector<hsize_t> extents(array.shape.begin(), array.shape.end());
  const hid_t space = H5Screate_simple(static_cast<int>(extents.size()), extents.data(), nullptr);
  const hid_t data =
      H5Dcreate2(handle, dataset.c_str(), H5T_IEEE_F32LE, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
  EXPECT_GE(H5Dwrite(data, H5T_NATIVE_FLOAT, H5S_ALL, H5S_ALL, H5P_DEFAULT, array.values.data()), 0) << file;
  H5Dclose(data);
  H5Sclose(space);
  H5Fclose(handle);
}

void write_hypersim_scene(const Scene& scene, const std::filesystem::path& folder) {
  const Camera& camera = scene.frames.front().camera;
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
                        hypersim_table(folder.filename().string(), camera));
}

}  // namespace gld::test
