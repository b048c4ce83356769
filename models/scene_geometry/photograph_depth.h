#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"
#include "gld/photogrammetry/source_depth.h"
#include "models/decoders/geometry_head.h"
#include "models/depth_refinement/refined_source_depth.h"

#include <optional>
#include <vector>

#include <torch/types.h>

#include <Eigen/Core>

namespace gld {

// The photographs of the source views as they are matched and kept: larger than the model takes them where they were
// taken larger.
struct SourcePhotographs {
  std::vector<PicturedView> views;  // without depth; the cameras are those of the source views, resized
  std::vector<Eigen::Vector3d>
      points_in_world;  // sparse points of a reconstruction, where the scene has them
};

// Returns what the model is shown, (sources, 3, height, width) in [0, 1], as photographs: it is for where no larger
// ones are at hand.
SourcePhotographs photographs_of_images(const Views& views, const torch::Tensor& source_images);

struct PhotographDepth {
  SourceDepth depth;
  StereoScene stereo;
  std::vector<PlanarDepth> head;  // the geometry head's alone, in the unit of the cameras; none without it
};

// How the depth of source views is found.
struct PhotographDepthOptions {
  std::optional<StereoOptions> stereo = StereoOptions();  // how photographs are matched; none: they are not
  const DepthRefinement* refinement = nullptr;            // mends what was matched; null for none
  double single_source_unit = 0;                          // as source_depth_of_head() takes it
  bool follows_edges = true;  // at last, its edges are those of the photographs (edge_following_depth.h)
};

// Returns the depth of the source views that sampling, training and evaluation carry them by: what their photographs
// agree on. head is what a geometry head says of the source views alone, depth and rays in its own unit, as the prior
// of the match; it is null for none. Nothing of one photograph can be matched: there, where photographs are not to be
// matched, and where hardly any pixel tells the unit, the head's depth counts as source_depth_of_head() brings it to
// the cameras' unit, or nothing is known. Of several photographs that are not to be matched a head has to say
// something.
PhotographDepth photograph_depth(const Views& views, const torch::Tensor& source_images,
                                 const SourcePhotographs& photographs, const GeometryOutput* head,
                                 const PhotographDepthOptions& options);

// Returns what a network that mends this depth and looks at pictures of that side is shown; nothing where the depth is
// not known, no head was asked or nothing was matched.
std::optional<ToldDepth> told_depth(const SourcePhotographs& photographs, const PhotographDepth& found,
                                    int64_t side);

// Has the network mend found.depth, where told_depth() has something to show it.
void refine(const DepthRefinement& refinement, const SourcePhotographs& photographs, PhotographDepth& found);

// Returns the depth of views in the unit of their cameras: what photographs agree on, as far as they show a view, and
// what a geometry head sees in the pictures of all views for the rest (gld/photogrammetry/fused_view_depth.h).
// predicted is (views, height, width) of the head, in its own unit, of the last so many of `views`. A view that no
// photograph shows keeps the head's depth in the unit that the other views tell. Returns nothing where none tells it,
// or where photographs confirm less than a tenth of the source views: so few pixels may match by chance.
std::vector<PlanarDepth> fused_view_depths(const Views& views, const torch::Tensor& source_images,
                                           const SourceDepth& depth, const StereoScene& stereo,
                                           const torch::Tensor& predicted);

}  // namespace gld
