#pragma once

#include "datasets/images/image.h"
#include "datasets/scenes/undistortion.h"
#include "gld/cameras/camera.h"

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include <Eigen/Core>

namespace gld {

// What HyperSim's metadata say about a scene's camera.
struct HypersimSettings {
  int64_t width = 1024;
  int64_t height = 768;
  double metres_per_asset_unit = 0;
  // Ray in the camera (x right, y up, z backwards) from (u, v, 1), u and v in [-1, 1], v up. Tilted lenses make it a
  // full 3x3 matrix.
  Eigen::Matrix3d camera_from_uv = Eigen::Matrix3d::Identity();
};

// Reads them from metadata_camera_parameters.csv beside the scene or up to three folders above it (columns
// M_cam_from_uv_ij, or the field of view of 60 degrees that scenes without a physical camera have), and the asset scale
// also from _detail/metadata_scene.csv. Throws Error when the scale is nowhere.
HypersimSettings read_hypersim_settings(const std::filesystem::path& scene);

// The ideal pinhole camera that sees the same rays: a tilted lens is a turned camera with other intrinsics (an RQ
// decomposition). What skew remains is removed by moving pixels.
class HypersimLens {
 public:
  explicit HypersimLens(const HypersimSettings& settings, const std::string& where);
  // Returns width, height and intrinsics; the pose is left to the frame.
  const Camera& camera() const { return camera_; }
  // stored is HyperSim's camera with OpenCV axes.
  const Eigen::Matrix3d& stored_from_camera() const { return stored_from_camera_; }
  double skew() const { return skew_; }  // pixels over the whole height
  Image image(const Image& stored) const;
  // Turns distance along the ray (metres) into planar depth.
  DepthMap planar_depth(const DepthMap& distance) const;

 private:
  Camera camera_;
  Eigen::Matrix3d stored_from_camera_ = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d pixel_from_ray_ = Eigen::Matrix3d::Identity();
  double skew_ = 0;
  std::shared_ptr<const Undistorter> undistorter_;  // where the skew can be seen
};

}  // namespace gld
