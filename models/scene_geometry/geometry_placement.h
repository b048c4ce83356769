#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/pose_alignment.h"
#include "gld/photogrammetry/depth_scale.h"
#include "gld/photogrammetry/planar_depth.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"
#include "models/decoders/geometry_head.h"

#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

#include <Eigen/Core>

namespace gld {

// DepthScale::estimator of ScaleEvidence::usual_unit_depth.
inline constexpr const char* kUsualUnitEvidence = "usual_unit";

// What may tell the scale of predicted depth beside the given cameras. What is left empty says nothing.
struct ScaleEvidence {
  bool camera_poses = true;  // the distances between the predicted cameras
  // (photographs, 3, height, width) in [0, 1], of the first views: they match where the scale is right. Pictures that
  // were generated do not, to a pixel, so they are no evidence.
  torch::Tensor photographs;
  // What the photographs of the first views agree on under the cameras, in the scene's unit, where they are
  // confident and not a number elsewhere; an empty map for a view without. Stands for `photographs`, which are not
  // asked then.
  std::vector<PlanarDepth> matched_depth;
  std::vector<Eigen::Vector3d> points_in_world;  // sparse points of a reconstruction
  // Depth measured in the first views, in the scene's unit; an empty map for a view without. Never that of a target.
  std::vector<PlanarDepth> source_depth;
  // Depth of a single source view in the unit that is usual for the model (source_depth_of_head() in source_warp.h):
  // a guess, as far as the deviation says.
  std::vector<PlanarDepth> usual_unit_depth;
  double usual_unit_log_deviation = 0;
};

// Returns matched_depth of what photographs were matched for: nothing where they are too seldom confident to tell a
// scale.
std::vector<PlanarDepth> confident_depth(const StereoScene& stereo);

// Where the geometry model's predictions lie in the scene. The model has a frame and a scale of its own; its predicted
// rays tell where it thinks the cameras are, the given cameras where they are.
struct GeometryPlacement {
  std::vector<Camera>
      predicted;  // in the model's frame and unit; empty where no camera fits some view's rays
  std::optional<PoseAlignment> alignment;  // of the predicted cameras with the given ones
  std::vector<DepthScale> estimates;  // one for each kind of evidence that says something, believed or not
  std::optional<DepthScale> scale;    // what those without doubt say together; nothing where all are in doubt
  std::string problem;                // why there are no predicted cameras; empty where there are

  // Leads from the model's frame to the scene's. Without a scale the model's unit stays, only turned and moved; without
  // predicted cameras the model's frame does.
  Similarity scene_from_model() const;
};

// given is the scene's camera of each view of the geometry. Without depth only the predicted cameras tell the scale.
GeometryPlacement place_geometry(const GeometryOutput& geometry, const std::vector<Camera>& given,
                                 const ScaleEvidence& evidence = {});

// Returns what every kind of evidence said, in a sentence's middle: "camera_poses says 586 but its fit leaves 93 % of
// what it is fitted to; ...".
std::string estimates_text(const std::vector<DepthScale>& estimates);

// Returns the cameras that depth in the scene's unit (or, without a scale, in the model's) belongs to, so that the
// views line up: the given ones where the scale is known, otherwise the predicted ones, turned and moved to where the
// given ones are. Returns nothing where there are none.
std::vector<Camera> cameras_of_depth(const GeometryPlacement& placement, const std::vector<Camera>& given);

}  // namespace gld
