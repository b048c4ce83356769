#pragma once

#include "gld/machine/instruction_set.h"
#include "gld/machine/matrix_unit.h"

#include <cstdint>

// Softmax attention on the CPU, forward and backward, on plain pointers: blocks of keys, online softmax, no
// matrix of logits, scratch independent of the product of the token counts. gld/attention/attention.h is the interface
// for tensors.
namespace gld {

struct AttentionShape {
  int64_t batch = 1;
  int64_t heads = 1;
  int64_t queries = 0;   // tokens
  int64_t keys = 0;      // tokens
  int64_t head_dim = 0;  // 1 to 256; multiples of 8 waste nothing
};

// A (batch, tokens, heads, head_dim) array whose channels are contiguous; strides in floats.
template <class Float>
struct StridedHeads {
  Float* data = nullptr;
  int64_t batch_stride = 0;
  int64_t token_stride = 0;
  int64_t head_stride = 0;
};

// The tables of gld/camera_encoding/prope.h as pointers. Tokens are views x (prefix_tokens + grid_height * grid_width);
// head_dim is a multiple of 8.
struct PropePointers {
  int64_t views = 0;
  int64_t prefix_tokens = 0;
  int64_t grid_height = 0;
  int64_t grid_width = 0;
  const float* query_matrix = nullptr;      // (views, 4, 4)
  const float* key_value_matrix = nullptr;  // (views, 4, 4)
  const float* output_matrix = nullptr;     // (views, 4, 4)
  const float* column_cos = nullptr;        // (grid_width, head_dim / 8)
  const float* column_sin = nullptr;
  const float* row_cos = nullptr;  // (grid_height, head_dim / 8)
  const float* row_sin = nullptr;
};

struct KernelSettings {
  int threads = 1;
  InstructionSet instruction_set = best_instruction_set();
  int64_t second_level_cache =
      second_level_cache_bytes();  // decides how products are cut up, not what they give
  // The precision of attention is kFloat32, or kBFloat16 on that unit, with softmax and sums in float32 and the arrays
  // float32 all the same. linear_product is float32; packed_product.h has the others.
  ComputePrecision precision = ComputePrecision::kFloat32;
  MatrixUnit unit = MatrixUnit::kPlain;
};

struct AttentionForward {
  AttentionShape shape;
  StridedHeads<const float> query;
  StridedHeads<const float> key;
  StridedHeads<const float> value;
  const PropePointers* prope = nullptr;
  StridedHeads<float> output;
  // (batch, heads, queries), the natural logarithm of the sum of exp(logit); -inf without keys. Null: not wanted.
  float* log_sum_exp = nullptr;
};

// Computes output = softmax(query key^T / sqrt(head_dim)) value, zero for a query without keys.
void attention_forward(const AttentionForward& arrays, const KernelSettings& settings);
// Returns the bytes of scratch that attention_forward allocates.
int64_t attention_forward_scratch_bytes(const AttentionForward& arrays, const KernelSettings& settings);

struct AttentionBackward {
  AttentionForward forward;  // with the output and log_sum_exp it produced
  StridedHeads<const float> output_gradient;
  StridedHeads<float> query_gradient;
  StridedHeads<float> key_gradient;
  StridedHeads<float> value_gradient;
};

// Computes the gradients of a loss with respect to query, key and value, in the precision that the output was computed
// in: the probabilities are those of its log_sum_exp. The same number of threads gives the same bits.
void attention_backward(const AttentionBackward& arrays, const KernelSettings& settings);

// These return the multiplications and additions of the products (the cost model's convention; softmax is not counted).
double attention_forward_flops(const AttentionShape& shape);   // 4 batch heads queries keys head_dim
double attention_backward_flops(const AttentionShape& shape);  // 10 batch heads queries keys head_dim

}  // namespace gld
