#include "infer/evaluate/carried_pictures.h"

#include "gld/cameras/relative_cameras.h"
#include "infer/pipeline/geometry_of_pictures.h"
#include "infer/pipeline/used_source_depth.h"
#include "infer/request/scene_request.h"
#include "models/scene_geometry/photograph_depth.h"
#include "models/scene_geometry/source_warp.h"

#include <optional>
#include <utility>
#include <vector>

namespace gld {

torch::Tensor nearest_sources(const Views& views, const torch::Tensor& source_images) {
  std::vector<torch::Tensor> images;
  for (int64_t target = views.num_sources; target < views.size(); ++target) {
    images.push_back(source_images[nearest_source(views, target)]);
  }
  return torch::stack(images);
}

FilledViews filled_by_true_depth(const SamplingScene& scene) {
  std::vector<PlanarDepth> maps;
  maps.reserve(scene.source_depths.size());
  for (const DepthMap& map : scene.source_depths) {
    if (map.empty()) return {};
    maps.push_back({map.width, map.height, map.metres});
  }
  const SourceDepth depth = depth_of_scene(std::move(maps));
  if (!depth.known()) return {};
  return filled_views(scene.views,
                      scene.photographs.views.empty()
                          ? photographs_of_images(scene.views, stacked(scene.source_images))
                          : scene.photographs,
                      depth);
}

CarriedPictures carried_pictures(const EvaluationModels& models, const SamplingScene& scene) {
  const auto pictures = stacked(scene.source_images);
  const SourcePhotographs photographs =
      scene.photographs.views.empty() ? photographs_of_images(scene.views, pictures) : scene.photographs;
  const PhotographUse& use = models.photographs;
  std::optional<GeometryOutput> head;
  if (models.bundle.geometry_head.predicts_rays()) {
    head = geometry_of_pictures(models.models, pictures, GeometryMaps::kDepthAndRays, models.device);
  } else if (!use.matches()) {
    return {{}, {}, kNoCameraHead, kNoCameraHead, {}};
  }
  const bool asks_head = use.depth != SourceDepthOrigin::kStereo;
  const SourceDepth depth = used_source_depth(models.models, use, scene.views, pictures, photographs,
                                              asks_head && head ? &*head : nullptr,
                                              models.bundle.unit_of_single_source(scene.views, scene.metric))
                                .depth;
  const SourceWarp warp = warp_sources(scene.views, pictures, depth, 1);
  const NearestSourceDepth nearest = nearest_source_depth(scene.views, depth);
  CarriedPictures carried{warp.completed, nearest.depth, warp.doubt, nearest.doubt, {}};
  if (depth.known()) carried.filled = filled_views(scene.views, photographs, depth);
  return carried;
}

}  // namespace gld
