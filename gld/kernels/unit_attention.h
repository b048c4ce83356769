#pragma once

#include "gld/kernels/attention_kernel.h"

namespace gld {

// attention_forward in bfloat16 on a matrix unit; called by it.
void unit_attention_forward(const AttentionForward& arrays, const KernelSettings& settings);
int64_t unit_attention_scratch_bytes(const AttentionForward& arrays, const KernelSettings& settings);

}  // namespace gld
