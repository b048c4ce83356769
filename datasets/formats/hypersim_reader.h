#pragma once

#include "datasets/formats/scene_reader.h"

#include <cstdint>
#include <filesystem>
#include <map>

#include <Eigen/Geometry>

namespace gld {

// Reads HyperSim as downloaded: _detail/cam_XX/camera_keyframe_{positions,orientations}.hdf5 (and frame_indices),
// images/scene_cam_XX_final_hdf5/frame.*.color.hdf5 (linear light; tone-mapped on loading) or
// scene_cam_XX_final_preview/frame.*.tonemap.jpg or .color.jpg,
// images/scene_cam_XX_geometry_hdf5/frame.*.depth_meters.hdf5 (distance along the ray, turned into planar depth). Each
// cam_XX is one part. Positions are scaled to metres; cameras are OpenGL (x right, y up, looking along -z).
class HypersimReader : public SceneReader {
 public:
  std::string name() const override { return "hypersim"; }
  std::string marker() const override { return "_detail/cam_XX/camera_keyframe_positions.hdf5"; }
  bool recognises(const std::filesystem::path& path) const override;
  std::vector<std::string> parts(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

// Returns world_from_camera by frame number, OpenCV axes, positions in metres. Poses are not checked yet.
std::map<int64_t, Eigen::Matrix4d> read_hypersim_trajectory(const std::filesystem::path& camera_folder,
                                                            double metres_per_asset_unit);

// Does the published tone mapping: the brightness at the 90th percentile becomes 0.8 on the screen, gamma is 2.2.
Image tone_mapped(const std::vector<float>& linear_rgb, int64_t width, int64_t height);

}  // namespace gld
