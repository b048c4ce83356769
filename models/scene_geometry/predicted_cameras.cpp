#include "models/scene_geometry/predicted_cameras.h"

#include "gld/base/error.h"

#include <algorithm>
#include <string>

namespace gld {
namespace {

// map is (height, width) or (height, width, numbers a pixel).
template <class Map>
Map to_map(const torch::Tensor& tensor) {
  const auto values = tensor.to(torch::kCPU, torch::kFloat32).contiguous();
  Map map(values.size(1), values.size(0));
  std::copy_n(values.data_ptr<float>(), values.numel(), map.values.begin());
  return map;
}

}  // namespace

ConfidenceMap to_confidence_map(const torch::Tensor& confidence) { return to_map<ConfidenceMap>(confidence); }

RayMap to_ray_map(const torch::Tensor& rays) { return to_map<RayMap>(rays); }

PointMap to_point_map(const torch::Tensor& points) { return to_map<PointMap>(points); }

std::vector<Camera> predicted_cameras(const GeometryOutput& geometry, const std::vector<Camera>& given) {
  if (geometry.rays.size(0) != static_cast<int64_t>(given.size())) {
    fail({"predicted cameras",
          "one given camera for each of " + std::to_string(geometry.rays.size(0)) + " ray maps",
          std::to_string(given.size()), "check the views"});
  }
  std::vector<Camera> cameras;
  for (size_t i = 0; i < given.size(); ++i) {
    const auto view = static_cast<int64_t>(i);
    const Eigen::Vector2d principal_point = given[i].intrinsics.block<2, 1>(0, 2);
    cameras.push_back(
        camera_from_rays(to_ray_map(geometry.rays[view]), to_confidence_map(geometry.ray_confidence[view]),
                         {given[i].width, given[i].height}, KnownIntrinsics{principal_point, {}})
            .camera);
  }
  return cameras;
}

}  // namespace gld
