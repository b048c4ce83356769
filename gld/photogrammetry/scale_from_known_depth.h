#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/depth_scale.h"
#include "gld/photogrammetry/planar_depth.h"

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace gld {

// A view's predicted depth, in the geometry model's unit, and its camera in the world.
struct DepthView {
  Camera camera;
  PlanarDepth depth;
};

// The estimator "sparse_points" takes the points of a reconstruction, in the world, beside the predicted depth of the
// pixels that they fall on. Which views saw a point is not asked: points behind a surface are wrong observations of a
// ScaleConsensus, those on it agree. Returns nothing where fewer than 20 fall into the views.
std::optional<DepthScale> scale_from_sparse_points(const std::vector<DepthView>& views,
                                                   const std::vector<Eigen::Vector3d>& points_in_world);

// Takes depth that is known in some views, measured or matched, one map a view in the world's unit, with no values for
// a view without one. Returns nothing where none has 20 known pixels.
std::optional<DepthScale> scale_from_measured_depth(const std::vector<DepthView>& views,
                                                    const std::vector<PlanarDepth>& measured,
                                                    const std::string& estimator);

}  // namespace gld
