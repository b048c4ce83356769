#pragma once

#include "gld/attention/attention.h"

#include <cstdint>

#include <torch/types.h>

namespace gld {

// The numbers are standard normal, float64.
torch::Tensor extreme_random(c10::IntArrayRef sizes, uint64_t seed);

// The inputs have one batch, two heads, float64, with logits of at most `size`. Queries and keys lie on a coarse grid
// times a power of two, so that their scalar products are exact in float32 and what is measured is the softmax.
AttentionInputs attention_inputs_with_logits(double size, int64_t tokens);

}  // namespace gld
