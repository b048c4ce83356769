#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/depth_scale.h"
#include "gld/cameras/pose_from_rays.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/decoders/dpt_head.h"

#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

// The cameras that a geometry model sees behind photographs that have none, and how far to believe them.
struct PhotoCameras {
  // One a photograph; the first one is the world, and the unit is the model's.
  std::vector<Camera> cameras;
  std::vector<RecoveredCamera> recovered;  // in the frame of the rays: how well each fits its rays
  double spread = 0;                       // root mean square distance of the centres from their mean
  double origin_error =
      0;  // median over the photographs of what the origins of one leave, in the model's unit
  double median_depth = 0;  // in the model's unit
  // What the photographs say of the depth under these cameras (gld/cameras/photo_consistency.h): the scale is 1 where
  // cameras and depth bear each other out. Nothing where the cameras stand at one place.
  std::optional<DepthScale> depth_check;

  // Why the places of the cameras are not to be relied on, as phrases; empty where they are.
  std::vector<std::string> doubts() const;
};

// What the DPT head says of views that are all given as pictures, (views, 3, height, width) in [0, 1]: depth and rays.
GeometryOutput geometry_of_photographs(const PipelineModels& models, const torch::Tensor& photographs,
                                       const torch::Device& device);

// Of that geometry. The principal points are the pictures' middles, as of photographs that were not cut off to one side.
// Throws Error naming the photograph where no camera fits its rays.
PhotoCameras photo_cameras(const GeometryOutput& geometry, const torch::Tensor& photographs);

// For report.json, one entry a photograph under `cameras`; names: one each.
nlohmann::ordered_json photo_cameras_json(const PhotoCameras& found, const std::vector<std::string>& names);
// For people: a line a photograph, what the photographs say together, and the doubts.
std::string photo_cameras_text(const PhotoCameras& found, const std::vector<std::string>& names);

}  // namespace gld
