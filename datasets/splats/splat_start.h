#pragma once

#include "datasets/images/image.h"
#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "gld/splatting/gaussian_set.h"

#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace gld {

// Where a fit begins.
struct SplatStartOptions : OptionsGroup {
  double opacity = 0.7;         // of Gaussians that depth put on a surface
  double sparse_opacity = 0.1;  // of those at sparse points, as 3DGS has it
  double spread = 0.6;          // standard deviation, in the distance to the next Gaussian

  void visit(FieldVisitor& visitor) override;
};

// A view of the fit. Image and depth have the camera's size; a view without depth has an empty map.
struct SplatPicture {
  Camera camera;
  Image image;
  DepthMap depth;
};

// The middle of the cameras, and how far the scene reaches as 3DGS counts it: 1.1 times the largest distance of a
// camera from it. Where all stand at one place, the median of what depth and points lie away.
struct SceneReach {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double extent = 1;
};
SceneReach scene_reach(const std::vector<SplatPicture>& pictures,
                       const std::vector<Eigen::Vector3d>& points_in_world);

// Makes one Gaussian a pixel with known depth, those in one voxel merged; voxels are as small as the cap allows, and
// not smaller than half the median pixel. Else it makes one a sparse point, its size from its three nearest neighbours,
// its colour from the views that it projects into. Colours are coefficient 0, of degree 0; means are relative to the
// reach's middle. Throws Error, named by `where`, without either.
GaussianSet start_gaussians(const std::vector<SplatPicture>& pictures,
                            const std::vector<Eigen::Vector3d>& points_in_world, const SceneReach& reach,
                            int64_t most_gaussians, const SplatStartOptions& options,
                            const std::string& where);

}  // namespace gld
