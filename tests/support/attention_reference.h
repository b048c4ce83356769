#pragma once

#include "gld/kernels/attention_kernel.h"

#include <cstdint>
#include <vector>

namespace gld::test {

// Attention and its gradients in double, written down from the definition: the oracle of the kernels. Arrays are
// (batch, tokens, heads, head_dim), contiguous.
struct ReferenceAttention {
  std::vector<double> query, key, value;
  std::vector<double> output;
  std::vector<double> log_sum_exp;  // (batch, heads, queries)
};

struct ReferenceGradients {
  std::vector<double> query, key, value;
};

// Fills output and log_sum_exp. prope is as in AttentionForward; it is null for none.
void run_reference(const AttentionShape& shape, const PropePointers* prope, ReferenceAttention& arrays);
ReferenceGradients reference_gradients(const AttentionShape& shape, const PropePointers* prope,
                                       const ReferenceAttention& arrays,
                                       const std::vector<double>& output_gradient);

}  // namespace gld::test
