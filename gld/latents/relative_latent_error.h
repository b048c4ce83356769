#pragma once

#include <torch/types.h>

namespace gld {

// Returns |latents - encoded| over |encoded - its mean|, (views, channels, height, width) each: 0 where they are what
// the backbone sees, 1 where they are no more than each channel's mean.
double relative_latent_error(const torch::Tensor& latents, const torch::Tensor& encoded);

}  // namespace gld
