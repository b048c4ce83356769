#include "infer/evaluate/pose_estimation.h"

#include "gld/base/error.h"
#include "gld/photogrammetry/published_pose_from_rays.h"
#include "models/decoders/camera_decoder.h"
#include "models/scene_geometry/predicted_cameras.h"

#include <algorithm>
#include <cstdint>

namespace gld {
namespace {

std::vector<RayGrid> ray_grids(const GeometryOutput& geometry) {
  std::vector<RayGrid> grids;
  for (int64_t view = 0; view < geometry.rays.size(0); ++view) {
    grids.push_back(
        ray_grid(to_ray_map(geometry.rays[view]), to_confidence_map(geometry.ray_confidence[view])));
  }
  return grids;
}

}  // namespace

const std::vector<std::string>& pose_estimator_names() {
  static const std::vector<std::string> names{"none", "ours", "da3", "gld", "vggt", "da3_decoder"};
  return names;
}

std::vector<Camera> estimated_cameras(PoseEstimator estimator, const GeometryOutput& geometry,
                                      const std::vector<Camera>& given) {
  switch (estimator) {
    case PoseEstimator::kOurs:
    case PoseEstimator::kVggt:  // its rays are exactly those of a pinhole camera
      return predicted_cameras(geometry, given);
    case PoseEstimator::kDa3:
      return cameras_from_rays_da3(ray_grids(geometry), {given.front().width, given.front().height});
    case PoseEstimator::kGld:
      return cameras_from_rays_gld(ray_grids(geometry), {given.front().width, given.front().height});
    case PoseEstimator::kDa3Decoder:
      if (!geometry.camera_encodings.defined()) {
        fail({"pose estimation", "cameras of a camera decoder", "none", "choose another one for --poses"});
      }
      return decoded_cameras(geometry.camera_encodings, {given.front().width, given.front().height});
    case PoseEstimator::kNone:
      break;
  }
  fail({"pose estimation", "an estimator", "none", "choose another one for --poses"});
}

}  // namespace gld
