#pragma once

#include "models/decoders/geometry_head.h"
#include "models/latent_spaces/latent_space.h"
#include "models/scene_geometry/photograph_depth.h"
#include "train/data/training_scene.h"

namespace gld {

// Returns the depth of a scene's source views as the network that mends depth is shown it: what frozen backbone and
// geometry head and the photographs themselves say. photographs are those of the source views, as large as the scene's
// images.
PhotographDepth source_view_depth(const LatentSpace& space, const GeometryHead& head,
                                  const TrainingScene& scene, const SourcePhotographs& photographs);

// Returns the same as sampling takes it: mended by `refinement`, where that is not null, and of a single source by the
// head alone in that unit (source_depth_of_head()). It is not known where nothing tells its unit.
SourceDepth sampled_source_depth(const LatentSpace& space, const GeometryHead& head,
                                 const DepthRefinement* refinement, const TrainingScene& scene,
                                 const SourcePhotographs& photographs, double single_source_unit);

}  // namespace gld
