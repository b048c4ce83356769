#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/source_depth.h"
#include "models/decoders/geometry_head.h"
#include "models/latent_spaces/latent_space.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// What is given of a scene: images, cameras, and depth where it is known already.
struct SourceScene {
  Views views;
  // (source views, 3, height, width), RGB in [0, 1], on the device of the latent space's backbone.
  torch::Tensor images;
  // This depth is of another origin than the geometry head, which is not asked then.
  std::optional<SourceDepth> depth;
  double single_source_unit = 0;  // as source_depth_of_head() takes it
};

// What generators and decoders take of the source views.
struct ConditioningNeeds {
  int64_t deepest_shown = 0;   // level of the source views
  int64_t warped_sources = 0;  // photographs in each target view, the most that a generator takes
  bool head_depth = false;     // what the geometry head says of the source views
  bool propagation = false;    // whether levels of all views will be propagated
};

// Returns the needs of generators that are shown levels up to that one and take so many photographs in each target
// view.
ConditioningNeeds conditioning_needs(const SourceScene& scene, int64_t deepest_shown, int64_t warped_sources);

// Levels 0 to this one of the source views are encoded, of so many that the backbone has.
int64_t deepest_encoded_level(const ConditioningNeeds& needs, int64_t levels);

// Source photographs as generators are shown them in the target views.
struct WarpedFeatures {
  torch::Tensor agreement;  // SourceWarp's; undefined where nothing was carried
  // Patch tokens of levels 0 to the deepest that is shown, as the backbone sees the completed pictures beside the
  // source photographs, (target views, patch tokens, C), raw; none where nothing was carried.
  std::vector<torch::Tensor> levels;
  std::string doubt;  // SourceWarp's
};

// A scene's source views as its generators and decoders take them: once a scene.
struct SourceConditioning {
  LatentGrid grid;  // of the source views
  // Raw features of levels 0 to the deepest that is shown, (sources, leading + patch tokens, C).
  std::vector<torch::Tensor> levels;
  torch::Tensor leading;        // LatentSpace::leading_for_propagation; undefined where nothing is propagated
  GeometryInputs for_geometry;  // of the source views alone; empty where the head's depth is not needed
  WarpedFeatures warped;
};

// Does the backbone's part: all but what is carried into target views.
SourceConditioning encode_sources(const LatentSpace& space, const torch::Tensor& source_images,
                                  const ConditioningNeeds& needs);

// Returns what the head says of source views that were encoded for it, in its own unit.
GeometryOutput source_geometry(const GeometryHead& head, const SourceConditioning& sources);

// Carries the photographs into the target views, and encodes what was carried. scene.depth must be there.
WarpedFeatures warp_into_targets(const LatentSpace& space, const SourceScene& scene,
                                 const ConditioningNeeds& needs);

// Does all of it, for who has the models at hand. head may be null where its depth is not needed.
SourceConditioning condition_on_sources(const LatentSpace& space, const GeometryHead* head,
                                        const SourceScene& scene, const ConditioningNeeds& needs);

}  // namespace gld
