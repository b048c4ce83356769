#pragma once

#include "datasets/images/image.h"
#include "datasets/pictures/colour_map.h"
#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "gld/cameras/pose_alignment.h"
#include "gld/photogrammetry/view_maps.h"

#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace gld {

// What turns a pixel and its depth into a point.
enum class PointLifting {
  kCameras,    // the view's camera
  kRays,       // the predicted ray map: origin + depth * direction (GLD's paper, section 5.7)
  kPointMaps,  // the predicted point of the pixel, of heads that have such (VGGT); depth only leaves pixels out
};

const std::vector<std::string>& point_lifting_names();

struct PointCloudOptions : OptionsGroup {
  PointLifting lifting = PointLifting::kCameras;
  double confidence_quantile = 0.25;
  double edge_step = 0.08;
  double far_limit = 20;
  int64_t max_points = 2'000'000;

  void visit(FieldVisitor& visitor) override;
};

// What one view adds to a cloud. Image, depth and confidence may have other sizes than the camera; their pixels cover
// the same picture evenly. The confidence may be empty: all pixels are equally sure.
struct PointView {
  Camera camera;  // in the world of the cloud
  Image image;
  DepthMap depth;
  ConfidenceMap confidence;
  // Only for PointLifting::kRays. The map is coarser than the depth; between the middles of its cells, and beyond the
  // outermost ones, rays are linear.
  RayMap rays;
  PointMap points;             // only for PointLifting::kPointMaps, of the depth's size
  Similarity world_from_rays;  // for both
};

// Pixels of all views, and why those that are no point were left out.
struct PointCounts {
  int64_t pixels = 0;
  int64_t unknown_depth =
      0;  // not positive and finite, or a confidence that is not, or a ray that is not finite
  int64_t low_confidence = 0;
  int64_t depth_edges = 0;
  int64_t too_far = 0;
  int64_t thinned = 0;
};

struct PointCloud {
  std::vector<Eigen::Vector3d> x_in_world;  // finite, and every coordinate below 1e30
  std::vector<Rgb> colours;
  std::vector<float> confidences;  // finite; 1 where the view has no confidence
  PointCounts counts;

  int64_t size() const { return static_cast<int64_t>(x_in_world.size()); }
};

// Lifts the depth of every view. depth_scale is the length of one unit of the depth maps, in the world where cameras
// lift (gld/photogrammetry/depth_scale.h finds it where the geometry head has a scale of its own), in the frame of the
// rays where they do. The order is view by view, row by row. A view whose depth and confidence differ in size, or whose
// image is empty, or that lacks the rays or points that lift it, is an Error.
PointCloud build_point_cloud(const std::vector<PointView>& views, double depth_scale,
                             const PointCloudOptions& options);

// Returns 1 where a pixel lies at a step of the surface. Inverse depth is affine on a plane seen in perspective, so its
// second difference between the two neighbours in a row or column, relative to the pixel's own inverse depth, is 0 on
// slanted planes and large at occlusions. Neighbours with unknown depth do not count. The result is (height, width).
std::vector<uint8_t> depth_edges(const DepthMap& depth, double step);

// Keeps the surest point of each cell of a cubic grid, the smallest tried with which at most max_points are left.
// Returns the length of a cell; 0 where none had to go.
double thin_point_cloud(PointCloud& cloud, int64_t max_points);

}  // namespace gld
