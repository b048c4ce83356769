#include "gld/photogrammetry/shared_sight.h"

#include "gld/cameras/resized_camera.h"

#include <Eigen/LU>

namespace gld {
namespace {

struct DepthCamera {
  Camera camera;  // of the depth's size
  Eigen::Matrix3d camera_from_pixel;
  Eigen::Isometry3d camera_from_world;
};

DepthCamera depth_camera(const PicturedView& view) {
  DepthCamera result;
  result.camera = resized_camera(view.camera, view.depth.width, view.depth.height);
  result.camera_from_pixel = result.camera.intrinsics.inverse();
  result.camera_from_world = result.camera.camera_from_world();
  return result;
}

bool shows(const DepthCamera& from, const PlanarDepth& depth, const Eigen::Vector3d& point_in_world) {
  const Eigen::Vector3d point = from.camera_from_world * point_in_world;
  if (!(point.z() > 0)) return false;
  const Eigen::Vector3d pixel = from.camera.intrinsics * point / point.z();
  const bool inside = pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() < static_cast<double>(depth.width) &&
                      pixel.y() < static_cast<double>(depth.height);
  if (!inside) return false;
  const auto column = static_cast<int64_t>(pixel.x()), row = static_cast<int64_t>(pixel.y());
  const float seen = depth.values[static_cast<size_t>(row * depth.width + column)];
  return PlanarDepth::known(seen) && point.z() <= (1 + kSightTolerance) * static_cast<double>(seen);
}

}  // namespace

std::vector<std::vector<uint8_t>> in_sight_of_others(const std::vector<PicturedView>& views) {
  std::vector<DepthCamera> cameras;
  cameras.reserve(views.size());
  for (const PicturedView& view : views) cameras.push_back(depth_camera(view));
  std::vector<std::vector<uint8_t>> masks;
  for (size_t own = 0; own < views.size(); ++own) {
    const PlanarDepth& depth = views[own].depth;
    std::vector<uint8_t> mask(depth.values.size(), 0);
    for (size_t i = 0; i < mask.size(); ++i) {
      if (!PlanarDepth::known(depth.values[i])) continue;
      const auto row = static_cast<int64_t>(i) / depth.width, column = static_cast<int64_t>(i) % depth.width;
      const Eigen::Vector3d middle(static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5, 1);
      const Eigen::Vector3d point =
          cameras[own].camera.world_from_camera *
          (cameras[own].camera_from_pixel * middle * static_cast<double>(depth.values[i]));
      for (size_t other = 0; other < views.size() && mask[i] == 0; ++other) {
        if (other != own && shows(cameras[other], views[other].depth, point)) mask[i] = 1;
      }
    }
    masks.push_back(std::move(mask));
  }
  return masks;
}

}  // namespace gld
