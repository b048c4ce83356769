#pragma once

// Products by a unit of tile registers: 8 registers of 16 rows x 64 bytes. Tiles is the hardware's (amx_tiles.h) or a
// plain one (plain_tiles.h); all that is above it, packing, blocking, edges and masks, is the same code.

#include "gld/kernels/unit_simd.h"

namespace gld {
namespace {

constexpr int64_t kTileSide = 16;  // rows of a register, and words of a row

// Tiles has clear<t>(), load<t>(words, stride) and store<t>(words, stride), with strides in words, and
// dot<kind, c, a, b>() for c[m][n] += sum over k of a[m][k] . b[k][n].
template <class Tiles>
struct TileUnit {
  // Two registers of rows and two of columns: every register that is loaded is multiplied twice.
  static constexpr int rows = 2 * kTileSide;
  static constexpr int64_t lanes = 2 * kTileSide;
  static constexpr int vectors = static_cast<int>(lanes) / Simd::lanes;
  static constexpr int64_t step_words = kTileSide;
  // A strip of 32 rows of 256 words is 32 KiB, in the first-level cache while panels of 512 KiB together pass.
  static constexpr int64_t block_words = 256;
  static constexpr int64_t block_columns = 512;

  using Session = typename Tiles::Session;

  // Does what DotUnit::multiply does; words is a multiple of step_words.
  template <OperandKind kind, class Finish>
  static GLD_INLINE void multiply(int64_t words, const uint32_t* a, int64_t a_stride, const uint32_t* b,
                                  int64_t b_stride, const Finish& finish) {
    Tiles tiles;
    tiles.template clear<0>();
    tiles.template clear<1>();
    tiles.template clear<2>();
    tiles.template clear<3>();
    for (int64_t k = 0; k < words; k += kTileSide) {
      tiles.template load<4>(a + k, a_stride);
      tiles.template load<6>(b + k * b_stride, b_stride);
      tiles.template dot<kind, 0, 4, 6>();
      tiles.template load<7>(b + k * b_stride + kTileSide, b_stride);
      tiles.template dot<kind, 1, 4, 7>();
      tiles.template load<5>(a + kTileSide * a_stride + k, a_stride);
      tiles.template dot<kind, 2, 5, 6>();
      tiles.template dot<kind, 3, 5, 7>();
    }
    alignas(64) float c[rows * lanes];
    tiles.template store<0>(c, lanes);
    tiles.template store<1>(c + kTileSide, lanes);
    tiles.template store<2>(c + kTileSide * lanes, lanes);
    tiles.template store<3>(c + kTileSide * lanes + kTileSide, lanes);
    for (int m = 0; m < rows; ++m) {
      for (int n = 0; n < vectors; ++n) finish(m, n, Simd::load(c + m * lanes + n * Simd::lanes));
    }
  }

  template <OperandKind kind>
  static double rounds(int64_t count) {
    Tiles tiles;
    tiles.template clear<0>();
    tiles.template clear<1>();
    tiles.template clear<2>();
    tiles.template clear<3>();
    tiles.template clear<4>();
    tiles.template clear<5>();
    tiles.template clear<6>();
    tiles.template clear<7>();
    for (int64_t round = 0; round < count; ++round) {
      tiles.template dot<kind, 0, 4, 6>();
      tiles.template dot<kind, 1, 4, 7>();
      tiles.template dot<kind, 2, 5, 6>();
      tiles.template dot<kind, 3, 5, 7>();
    }
    float c[kTileSide * kTileSide];
    tiles.template store<0>(c, kTileSide);
    asm volatile("" : : "r"(c) : "memory");
    const double numbers_a_word = kind == OperandKind::kBFloat16 ? 2 : 4;
    return static_cast<double>(count) * 4 * static_cast<double>(kTileSide * kTileSide * kTileSide) * 2 *
           numbers_a_word;
  }
};

}  // namespace
}  // namespace gld
