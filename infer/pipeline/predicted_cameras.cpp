#include "infer/pipeline/predicted_cameras.h"

#include <algorithm>

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

std::vector<Camera> predicted_cameras(const GeometryOutput& geometry, const ImageSize& picture) {
  std::vector<Camera> cameras;
  for (int64_t i = 0; i < geometry.rays.size(0); ++i) {
    cameras.push_back(camera_from_rays(to_ray_map(geometry.rays[i]),
                                       to_confidence_map(geometry.ray_confidence[i]), picture,
                                       PrincipalPoint::kCentre)
                          .camera);
  }
  return cameras;
}

}  // namespace gld
