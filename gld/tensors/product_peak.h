#pragma once

namespace gld {

// Returns the floating-point operations a second of a large float32 matrix product with LibTorch's present thread
// setting: how good the installed BLAS is. It is the best of a few products of 0.01 to 0.1 s.
double measure_sgemm_peak();

}  // namespace gld
