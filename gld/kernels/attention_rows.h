#pragma once

#include "gld/kernels/attention_kernel.h"
#include "gld/kernels/kernel_table.h"

#include <algorithm>
#include <cmath>
#include <vector>

// What attention in float32 and on matrix units share: tokens in tiles, and rows of strided arrays with their camera
// encoding.
namespace gld {

constexpr double kLog2E = 1.4426950408889634;
constexpr double kLn2 = 0.6931471805599453;
constexpr int64_t kTilesAThread = 16;
constexpr int64_t kBackwardTilesAThread = 8;  // of one head
constexpr int64_t kPrefetchRows = 16;

// Returns what packed queries are multiplied by: logits are then exponents of 2. It is one number for both passes,
// because the backward pass computes probabilities from the logits and the log-sum-exp of the forward pass.
inline float query_factor(int64_t head_dim) {
  return static_cast<float>(kLog2E / std::sqrt(static_cast<double>(head_dim)));
}

// Returns all tokens in runs of as many as fit the lanes of one tile.
std::vector<TokenRange> tiles(int64_t tokens, int64_t lanes);

// A run of (batch, head) pairs, counted head first.
struct HeadRange {
  int64_t first;
  int64_t count;
};

enum class Encoding { query, key_value, output };

// The row encodings of one kind, or their transposes (which gradients go through).
class Encoder {
 public:
  Encoder(const AttentionForward& arrays, const KernelTable& kernels)
      : prope_(arrays.prope), kernels_(kernels), head_dim_(arrays.shape.head_dim) {}

  void apply(Encoding encoding, int64_t token, float factor, const float* x, float* y) const {
    PropeRow row;
    kernels_.encode_row(find(encoding, token, row), head_dim_, factor, x, y);
  }

  void apply_transposed(Encoding encoding, int64_t token, float factor, const float* x, float* y) const {
    PropeRow row;
    const PropeRow* found = find(encoding, token, row);
    row.transposed_matrix = true;
    row.inverse_rotation = !row.inverse_rotation;
    kernels_.encode_row(found, head_dim_, factor, x, y);
  }

 private:
  // Returns null for tokens that are not encoded.
  const PropeRow* find(Encoding encoding, int64_t token, PropeRow& row) const;

  const PropePointers* prope_;
  const KernelTable& kernels_;
  int64_t head_dim_;
};

template <class Float>
Float* row_of(const StridedHeads<Float>& array, int64_t batch, int64_t head, int64_t token) {
  return array.data + batch * array.batch_stride + head * array.head_stride + token * array.token_stride;
}

// Rows of one head lie far apart in an array of all heads, where the processor sees no stream to fetch ahead.
inline void prefetch_row(const float* row, int64_t head_dim) {
  for (int64_t c = 0; c < head_dim; c += 16) __builtin_prefetch(row + c);
}

inline void clear_tail(float* row, int64_t head_dim, int64_t stride) {
  std::fill(row + head_dim, row + stride, 0.0f);
}

// Throws Error for shapes that do not fit together.
void check_attention(const AttentionForward& arrays, const KernelSettings& settings);

}  // namespace gld
