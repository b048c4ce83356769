#include "models/scene_geometry/photograph_depth.h"

#include "gld/cameras/resized_camera.h"
#include "gld/photogrammetry/matched_source_depth.h"
#include "gld/tensors/torch_version.h"
#include "models/scene_geometry/source_warp.h"
#include "models/scene_geometry/tensor_pictures.h"

#include <utility>

namespace gld {

SourcePhotographs photographs_of_images(const Views& views, const torch::Tensor& source_images) {
  SourcePhotographs photographs;
  for (int64_t i = 0; i < source_images.size(0); ++i) {
    PicturedView view;
    view.camera = views.cameras[static_cast<size_t>(i)];
    view.width = source_images.size(3);
    view.height = source_images.size(2);
    view.rgb = pixels_of(source_images[i]);
    photographs.views.push_back(std::move(view));
  }
  return photographs;
}

PhotographDepth photograph_depth(const Views& views, const torch::Tensor& source_images,
                                 const SourcePhotographs& photographs, const GeometryOutput* head,
                                 const StereoOptions& options) {
  PhotographDepth result;
  SourceDepth& depth = result.depth;
  if (views.num_sources < 2) {
    depth.doubt = "the depth of a single source view has no scale";
    return result;
  }
  std::vector<PicturedView> matched = photographs.views;
  if (head != nullptr) {
    for (size_t i = 0; i < matched.size(); ++i) {
      const auto map = head->depth[static_cast<int64_t>(i)];
      matched[i].depth = {map.size(1), map.size(0), numbers_of(map)};
    }
  }
  KernelSettings settings;
  settings.threads = static_cast<int>(thread_count());
  result.stereo = stereo_depth(matched, photographs.points_in_world, options, settings);
  // The prior's unit is free: photographs that agree nowhere leave it open.
  const bool open_unit = head != nullptr && (!result.stereo.prior || result.stereo.prior->pixels == 0);
  if (open_unit) {
    depth = source_depth_of_head(views, source_images, *head);
    return result;
  }
  depth = matched_source_depth(result.stereo);
  depth.from = head != nullptr ? "photographs and geometry head" : "photographs";
  return result;
}

}  // namespace gld
