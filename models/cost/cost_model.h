#pragma once

#include "gld/cameras/camera.h"
#include "models/decoders/rgb_decoder.h"
#include "models/dit/dit_options.h"
#include "models/layers/operation_cost.h"

#include <cstdint>

namespace gld {

// These functions give the Cost (models/layers/operation_cost.h) of one forward pass of each part; a backbone and a
// geometry head say their own (models/backbones/backbone.h, models/decoders/geometry_head.h).

Cost condition_encoder_cost(const DitOptions& options, const LatentGrid& grid);
// Counts everything but the condition encoder: projector, embedder, velocity decoder, final layer.
Cost velocity_decoder_cost(const DitOptions& options, const LatentGrid& grid);
// Counts one evaluation of one branch. Camera embedding and patch embedders, which exact savings move out of it, are
// left out (under 1 %).
Cost dit_cost(const DitOptions& options, const LatentGrid& grid);

Cost rgb_decoder_cost(const RgbDecoderOptions& options, const LatentGrid& grid);

}  // namespace gld
