#pragma once

#include "gld/cameras/camera.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/decoders/geometry_head.h"

#include <cstdint>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Returns what the geometry model sees in finished pictures, (views, 3, height, width) in [0, 1]: the model that
// models.geometry_model_backbone belongs to, or else the models' own backbone and head. Pictures whose sides are no
// whole patches of it are resized for it; maps of pixels come back in the pictures' size, on the pictures' device.
// known_cameras are those of the pictures, which the backbone is told (it throws Error where it takes none); where they
// are empty, it finds them itself.
GeometryOutput geometry_of_pictures(const PipelineModels& models, const torch::Tensor& pictures,
                                    GeometryMaps maps, const torch::Device& device,
                                    const std::vector<Camera>& known_cameras = {});

// Throws Error naming the stage and the map where a value of depth, rays or points is not finite: they would be written
// as unknown depth, of which a whole picture looks like an answer.
void require_finite_geometry(const GeometryOutput& geometry, const std::string& stage);

}  // namespace gld
