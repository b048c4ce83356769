#pragma once

#include "gld/cameras/camera.h"
#include "models/backbones/da3_backbone.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/rgb_decoder.h"
#include "models/dit/dit_options.h"

#include <cstdint>

namespace gld {

// Floating point operations (a multiplication and an addition are two) and memory of one forward pass of each part
// (NUMBERS.md, "Cost of the published model"). Matrix products and attention are counted, element-wise work is not.
struct Cost {
  double linear_flop = 0;       // matrix products with weights
  double convolution_flop = 0;  // those that LibTorch runs as such
  double attention_flop = 0;    // q k^T and p v
  int64_t weight_bytes = 0;     // of these products, in float32
  int64_t working_bytes =
      0;  // activations alive at one time while sampling, roughly; of a DiT only as a whole

  double flop() const { return linear_flop + convolution_flop + attention_flop; }
};

Cost condition_encoder_cost(const DitOptions& options, const LatentGrid& grid);
// Everything but the condition encoder: projector, embedder, velocity decoder, final layer.
Cost velocity_decoder_cost(const DitOptions& options, const LatentGrid& grid);
// One evaluation of one branch. Camera embedding and patch embedders, which exact savings move out of it, are left
// out (under 1 %).
Cost dit_cost(const DitOptions& options, const LatentGrid& grid);

// Blocks first_block up to, not including, last_block.
Cost backbone_cost(const Da3BackboneOptions& options, const LatentGrid& grid, int64_t first_block,
                   int64_t last_block);
Cost rgb_decoder_cost(const RgbDecoderOptions& options, const LatentGrid& grid);
Cost dpt_head_cost(const DptHeadOptions& options, const LatentGrid& grid, GeometryMaps maps);

}  // namespace gld
