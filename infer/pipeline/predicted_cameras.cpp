#include "infer/pipeline/predicted_cameras.h"

#include "gld/base/error.h"

#include <algorithm>
#include <string>

namespace gld {

ConfidenceMap to_confidence_map(const torch::Tensor& confidence) {
  const auto values = confidence.to(torch::kCPU, torch::kFloat32).contiguous();
  ConfidenceMap map(values.size(1), values.size(0));
  std::copy_n(values.data_ptr<float>(), values.numel(), map.values.begin());
  return map;
}

RayMap to_ray_map(const torch::Tensor& rays) {
  const auto values = rays.to(torch::kCPU, torch::kFloat32).contiguous();
  RayMap map(values.size(1), values.size(0));
  std::copy_n(values.data_ptr<float>(), values.numel(), map.values.begin());
  return map;
}

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
