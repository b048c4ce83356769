#pragma once

#include "infer/pipeline/sampling_stages.h"
#include "models/decoders/geometry_head.h"

namespace gld {

// What gld sample is asked to make.
struct RequestedOutputs {
  bool image = false;
  bool depth = false;
  bool rays = false;
  bool points = false;
  bool latents = false;
  bool splats = false;              // with images and depth, which Gaussians are fitted to
  bool page = false;                // report.html, of what else there is
  bool geometry_of_images = false;  // geometry is what another model sees in the generated images

  bool needs_depth() const { return depth || points; }
  // Depth takes its scale from the rays too, and its cameras where that leaves the scale open.
  bool needs_rays() const { return rays || needs_depth(); }
  bool needs_geometry() const { return needs_depth() || needs_rays(); }
  // Points are coloured by the images.
  bool needs_image() const { return image || points || (geometry_of_images && needs_geometry()); }

  DecodedViews image_views() const { return needs_image() ? DecodedViews::kTargets : DecodedViews::kNone; }
  DecodedViews geometry_views() const {
    // What photographs say of the scale of depth they say of the source views'.
    return !needs_geometry() ? DecodedViews::kNone
           : needs_depth()   ? DecodedViews::kAll
                             : DecodedViews::kTargets;
  }
  GeometryMaps geometry_maps() const {
    return needs_depth() ? GeometryMaps::kDepthAndRays : GeometryMaps::kRays;
  }
};

}  // namespace gld
