#include "train/objectives/source_view_depth.h"

#include "models/conditioning/source_conditioning.h"

#include <optional>

#include <torch/autograd.h>

namespace gld {

namespace {

GeometryOutput said_of_sources(const LatentSpace& space, const GeometryHead& head,
                               const torch::Tensor& pictures) {
  ConditioningNeeds needs;
  needs.head_depth = true;
  return source_geometry(head, encode_sources(space, pictures, needs));
}

torch::Tensor source_pictures(const TrainingScene& scene) {
  return scene.images.slice(0, 0, scene.views.num_sources);
}

}  // namespace

PhotographDepth source_view_depth(const LatentSpace& space, const GeometryHead& head,
                                  const TrainingScene& scene, const SourcePhotographs& photographs) {
  const torch::NoGradGuard no_grad;
  const auto pictures = source_pictures(scene);
  const GeometryOutput said = said_of_sources(space, head, pictures);
  PhotographDepthOptions options;
  options.follows_edges = false;
  return photograph_depth(scene.views, pictures, photographs, &said, options);
}

SourceDepth sampled_source_depth(const LatentSpace& space, const GeometryHead& head,
                                 const DepthRefinement* refinement, const TrainingScene& scene,
                                 const SourcePhotographs& photographs, double single_source_unit) {
  const torch::NoGradGuard no_grad;
  const auto pictures = source_pictures(scene);
  PhotographDepthOptions options;
  options.refinement = refinement;
  options.single_source_unit = single_source_unit;
  std::optional<GeometryOutput> said;
  if (scene.views.num_sources > 1 || single_source_unit > 0) said = said_of_sources(space, head, pictures);
  return photograph_depth(scene.views, pictures, photographs, said ? &*said : nullptr, options).depth;
}

}  // namespace gld
