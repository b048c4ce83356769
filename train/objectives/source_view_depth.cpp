#include "train/objectives/source_view_depth.h"

#include "models/conditioning/source_conditioning.h"

#include <utility>

#include <torch/autograd.h>

namespace gld {

PhotographDepth source_view_depth(const LatentSpace& space, const GeometryHead& head,
                                  const TrainingScene& scene, const SourcePhotographs& photographs) {
  const torch::NoGradGuard no_grad;
  const auto pictures = scene.images.slice(0, 0, scene.views.num_sources);
  ConditioningNeeds needs;
  needs.head_depth = true;
  const GeometryOutput said = source_geometry(head, encode_sources(space, pictures, needs));
  return photograph_depth(scene.views, pictures, photographs, &said, StereoOptions());
}

SourceDepth sampled_source_depth(const LatentSpace& space, const GeometryHead& head,
                                 const DepthRefinement* refinement, const TrainingScene& scene,
                                 const SourcePhotographs& photographs) {
  PhotographDepth found = source_view_depth(space, head, scene, photographs);
  if (refinement != nullptr) refine(*refinement, photographs, found);
  return std::move(found.depth);
}

}  // namespace gld
