#pragma once

#include "datasets/images/image.h"
#include "gld/cameras/camera.h"
#include "gld/cameras/depth_scale.h"
#include "gld/cameras/pose_alignment.h"
#include "infer/export/point_cloud.h"
#include "models/decoders/geometry_head.h"

#include <optional>
#include <string>
#include <vector>

namespace gld {

// Where the geometry model's predictions lie in the scene. The model has a frame and a scale of its own; its predicted
// rays tell where it thinks the cameras are, the given cameras where they are.
struct GeometryPlacement {
  std::vector<Camera>
      predicted;  // in the model's frame and unit; empty where no camera fits some view's rays
  std::optional<PoseAlignment> alignment;  // of the predicted cameras with the given ones
  std::optional<DepthScale> scale;         // nothing where the cameras do not tell it
  std::string problem;                     // why there are no predicted cameras; empty where there are

  // From the model's frame to the scene's. Without a scale the model's unit stays, only turned and moved; without
  // predicted cameras the model's frame does.
  Similarity scene_from_model() const;
};

// given: the scene's camera of each view of the geometry.
GeometryPlacement place_geometry(const GeometryOutput& geometry, const std::vector<Camera>& given);

// The cameras that depth in the scene's unit (or, without a scale, in the model's) belongs to, so that the views line up:
// the given ones where the scale is known, otherwise the predicted ones, turned and moved to where the given ones are.
// Nothing where there are none.
std::vector<Camera> cameras_of_depth(const GeometryPlacement& placement, const std::vector<Camera>& given);

// The cloud of all views, images one a view, in the frame of scene_from_model(). Where options.lifting asks for
// cameras and there are none, rays lift.
PointCloud point_cloud_of(const GeometryOutput& geometry, const GeometryPlacement& placement,
                          const std::vector<Camera>& given, const std::vector<Image>& images,
                          const PointCloudOptions& options);

// What point_cloud_of uses.
PointLifting lifting_of(const GeometryPlacement& placement, const PointCloudOptions& options);

}  // namespace gld
