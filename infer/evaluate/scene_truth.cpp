#include "infer/evaluate/scene_truth.h"

#include "datasets/loading/batching.h"
#include "infer/request/scene_request.h"

#include <algorithm>
#include <utility>
#include <vector>

namespace gld {
namespace {

// Sources first.
std::vector<DepthMap> depths_of_all_views(const SamplingScene& scene) {
  std::vector<DepthMap> depths = scene.source_depths;
  depths.insert(depths.end(), scene.true_depths.begin(), scene.true_depths.end());
  return depths;
}

}  // namespace

torch::Tensor true_images(const SamplingScene& scene) {
  const auto& images = scene.true_images;
  const bool complete = std::none_of(images.begin(), images.end(), [](const Image& i) { return i.empty(); });
  return complete ? stacked(images) : torch::Tensor();
}

torch::Tensor true_depth(const SamplingScene& scene) {
  bool any = false;
  std::vector<torch::Tensor> maps;
  for (const DepthMap& depth : scene.true_depths) {
    any = any || !depth.empty();
    maps.push_back(depth.empty() ? torch::zeros({scene.size.height, scene.size.width}) : to_tensor(depth));
  }
  return any ? torch::stack(maps) : torch::Tensor();
}

torch::Tensor points_of(const PointCloud& cloud) {
  torch::Tensor points = torch::empty({cloud.size(), 3}, torch::kFloat64);
  for (int64_t i = 0; i < cloud.size(); ++i) {
    Eigen::Map<Eigen::Vector3d>(points.data_ptr<double>() + 3 * i) = cloud.x_in_world[static_cast<size_t>(i)];
  }
  return points;
}

torch::Tensor all_true_depth(const SamplingScene& scene) {
  std::vector<torch::Tensor> maps;
  for (const DepthMap& depth : depths_of_all_views(scene)) {
    if (depth.empty()) return {};
    maps.push_back(to_tensor(depth));
  }
  return static_cast<int64_t>(maps.size()) == scene.views.size() ? torch::stack(maps) : torch::Tensor();
}

torch::Tensor true_surface(const SamplingScene& scene) {
  const std::vector<DepthMap> depths = depths_of_all_views(scene);
  const bool complete =
      static_cast<int64_t>(depths.size()) == scene.views.size() &&
      std::none_of(depths.begin(), depths.end(), [](const DepthMap& d) { return d.empty(); });
  if (!complete) return {};
  std::vector<PointView> views;
  for (size_t i = 0; i < depths.size(); ++i) {
    PointView view;
    view.camera = scene.views.cameras[i];
    view.image = Image(1, 1);
    view.depth = depths[i];
    views.push_back(std::move(view));
  }
  PointCloudOptions all;
  all.confidence_quantile = 0;
  all.edge_step = 1e6;
  all.far_limit = 0;
  return points_of(build_point_cloud(views, 1, all));
}

}  // namespace gld
