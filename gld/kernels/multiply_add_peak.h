#pragma once

#include "gld/kernels/attention_kernel.h"

namespace gld {

// Floating-point operations a second that independent multiply-adds in registers reach with the given instruction set
// and number of threads: the "peak" that fractions of peak refer to. Takes a few milliseconds; the best of `repeats`
// short runs, because anything else on the machine can only slow a run down.
struct PeakMeasurement {
  KernelSettings settings;
  int repeats = 3;
};
double measure_multiply_add_peak(const PeakMeasurement& measurement);

}  // namespace gld
