#pragma once

// The tile registers of AMX. Linux gives a process leave to use them (gld/machine/matrix_unit.cpp); their shape is
// state of each thread, set at the start of every kernel call and given back at its end, so that no thread carries 8
// KiB of tiles through its context switches for longer.

#include "gld/kernels/tile_unit.h"

namespace gld {
namespace {

class AmxTiles {
 public:
  class Session {
   public:
    Session() {
      struct alignas(64) Shape {
        uint8_t palette;
        uint8_t start_row;
        uint8_t reserved[14];
        uint16_t row_bytes[16];
        uint8_t rows[16];
      } shape = {};
      shape.palette = 1;
      for (int t = 0; t < 8; ++t) {
        shape.row_bytes[t] = kTileSide * sizeof(uint32_t);
        shape.rows[t] = kTileSide;
      }
      // Not the intrinsic: that of g++ 12 tells the compiler that only the first 8 bytes are read.
      asm volatile("ldtilecfg %0" : : "m"(shape));
    }
    ~Session() { asm volatile("tilerelease"); }
    Session(const Session&) = delete;
    Session& operator=(const Session&) = delete;
  };

  // The intrinsics take the register's number as text, which a template argument is not.
  template <int t>
  static GLD_INLINE void clear() {
    asm volatile("tilezero %%tmm%c0" : : "n"(t));
  }
  template <int t, class Word>
  static GLD_INLINE void load(const Word* from, int64_t stride) {
    asm volatile("tileloadd (%1,%2,1), %%tmm%c0"
                 :
                 : "n"(t), "r"(from), "r"(stride * static_cast<int64_t>(sizeof(Word)))
                 : "memory");
  }
  template <int t, class Word>
  static GLD_INLINE void store(Word* to, int64_t stride) {
    asm volatile("tilestored %%tmm%c0, (%1,%2,1)"
                 :
                 : "n"(t), "r"(to), "r"(stride * static_cast<int64_t>(sizeof(Word)))
                 : "memory");
  }
  template <OperandKind kind, int c, int a, int b>
  static GLD_INLINE void dot() {
    if constexpr (kind == OperandKind::kBFloat16) {
      asm volatile("tdpbf16ps %%tmm%c2, %%tmm%c1, %%tmm%c0" : : "n"(c), "n"(a), "n"(b));
    } else {
      asm volatile("tdpbusd %%tmm%c2, %%tmm%c1, %%tmm%c0" : : "n"(c), "n"(a), "n"(b));
    }
  }
};

}  // namespace
}  // namespace gld
