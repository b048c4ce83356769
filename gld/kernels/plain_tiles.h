#pragma once

// The tile registers of tile_unit.h in memory, and their products in loops.

#include "gld/kernels/tile_unit.h"

namespace gld {
namespace {

class PlainTiles {
 public:
  struct Session {};

  template <int t>
  GLD_INLINE void clear() {
    __builtin_memset(words_[t], 0, sizeof(words_[t]));
  }
  template <int t, class Word>
  GLD_INLINE void load(const Word* from, int64_t stride) {
    for (int64_t row = 0; row < kTileSide; ++row)
      __builtin_memcpy(words_[t][row], from + row * stride, kRowBytes);
  }
  template <int t, class Word>
  GLD_INLINE void store(Word* to, int64_t stride) const {
    for (int64_t row = 0; row < kTileSide; ++row)
      __builtin_memcpy(to + row * stride, words_[t][row], kRowBytes);
  }
  template <OperandKind kind, int c, int a, int b>
  GLD_INLINE void dot() {
    for (int64_t m = 0; m < kTileSide; ++m) {
      if constexpr (kind == OperandKind::kBFloat16) {
        float sums[kTileSide];
        __builtin_memcpy(sums, words_[c][m], sizeof(sums));
        for (int64_t k = 0; k < kTileSide; ++k) {
          const float low = low_half(words_[a][m][k]), high = high_half(words_[a][m][k]);
          for (int64_t n = 0; n < kTileSide; ++n) {
            sums[n] += low * low_half(words_[b][k][n]) + high * high_half(words_[b][k][n]);
          }
        }
        __builtin_memcpy(words_[c][m], sums, sizeof(sums));
      } else {
        for (int64_t n = 0; n < kTileSide; ++n) {
          int32_t sum = static_cast<int32_t>(words_[c][m][n]);
          for (int64_t k = 0; k < kTileSide; ++k) {
            for (int byte = 0; byte < 4; ++byte) {
              sum += static_cast<int32_t>(words_[a][m][k] >> 8 * byte & 0xffU) *
                     static_cast<int8_t>(words_[b][k][n] >> 8 * byte & 0xffU);
            }
          }
          words_[c][m][n] = static_cast<uint32_t>(sum);
        }
      }
    }
  }

 private:
  static constexpr std::size_t kRowBytes = kTileSide * sizeof(uint32_t);

  static GLD_INLINE float low_half(uint32_t word) { return float_of(static_cast<uint16_t>(word)); }
  static GLD_INLINE float high_half(uint32_t word) { return float_of(static_cast<uint16_t>(word >> 16)); }

  alignas(64) uint32_t words_[8][kTileSide][kTileSide];
};

}  // namespace
}  // namespace gld
