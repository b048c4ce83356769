#pragma once

#include "gld/kernels/attention_kernel.h"

namespace gld {

// attention_forward and attention_backward in bfloat16 on a matrix unit; called by them.
void unit_attention_forward(const AttentionForward& arrays, const KernelSettings& settings);
int64_t unit_attention_scratch_bytes(const AttentionForward& arrays, const KernelSettings& settings);
void unit_attention_backward(const AttentionBackward& arrays, const KernelSettings& settings);

}  // namespace gld
