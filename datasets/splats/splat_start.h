#pragma once

#include "datasets/images/image.h"
#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "gld/splatting/gaussian_set.h"

#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace gld {

// What Gaussians begin on: measured or predicted depth of the pictures; sparse points, which are few, but grow by
// density control; the depth that the pictures agree on. kAuto is the first of these that there is (docs/SPLATS.md has
// what each is worth).
enum class SplatStartFrom { kAuto, kDepth, kMatch, kPoints };
inline const std::vector<std::string>& splat_start_names() {
  static const std::vector<std::string> names{"auto", "depth", "match", "points"};
  return names;
}

// Where a fit begins.
struct SplatStartOptions : OptionsGroup {
  SplatStartFrom from = SplatStartFrom::kAuto;
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
  std::vector<uint8_t>
      valid;  // (height, width) 0 where the picture says nothing; empty where it does everywhere

  bool says(int64_t x, int64_t y) const {
    return valid.empty() || valid[static_cast<size_t>(y * image.width + x)] != 0;
  }
};

// The middle of the cameras, and how far the scene reaches as 3DGS counts it: 1.1 times the largest distance of a
// camera from it. Where all stand at one place, the median of what depth and points lie away.
struct SceneReach {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double extent = 1;
};
SceneReach scene_reach(const std::vector<SplatPicture>& pictures,
                       const std::vector<Eigen::Vector3d>& points_in_world);

// Returns what a fit begins on that asks for `from` and has depth, sparse points or neither.
SplatStartFrom settled_start(SplatStartFrom from, bool has_depth, bool has_points);
// Returns what a fit of these pictures begins on. Throws Error, named by `where`, where there is nothing, or not what
// was asked for.
SplatStartFrom start_of(const std::vector<SplatPicture>& pictures,
                        const std::vector<Eigen::Vector3d>& points_in_world, SplatStartFrom from,
                        const std::string& where);

// Makes one Gaussian a pixel with known depth, those in one voxel merged; voxels are as small as the cap allows, and
// not smaller than half the median pixel. Else it makes one a sparse point, its size from its three nearest neighbours,
// its colour from the views that it projects into. Colours are coefficient 0, of degree 0; means are relative to the
// reach's middle. options.from is not kAuto; pictures have the depth that was matched where it is kMatch. Throws Error,
// named by `where`, where there is nothing to begin on.
GaussianSet start_gaussians(const std::vector<SplatPicture>& pictures,
                            const std::vector<Eigen::Vector3d>& points_in_world, const SceneReach& reach,
                            int64_t most_gaussians, const SplatStartOptions& options,
                            const std::string& where);

}  // namespace gld
