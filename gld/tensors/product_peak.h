#pragma once

namespace gld {

// Floating-point operations a second of a large float32 matrix product with LibTorch's present thread setting: how good
// the installed BLAS is. The best of a few products of 0.01 to 0.1 s.
double measure_sgemm_peak();

}  // namespace gld
