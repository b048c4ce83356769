#include "gld/kernels/multiply_add_peak.h"

#include "gld/kernels/kernel_table.h"

#include <algorithm>
#include <chrono>

namespace gld {
namespace {

// They take about 3 ms on a processor with two wide multiply-add units.
constexpr int64_t kRounds = 200000;
constexpr int kLeastMilliseconds = 200;

}  // namespace

double measure_multiply_add_peak(const PeakMeasurement& measurement) {
  const KernelTable& kernels = kernel_table(measurement.settings.instruction_set);
  double best = 0;
  // The first repeats may find all threads on one core: the measurement goes on until the scheduler has had time to
  // spread them.
  const auto begun = std::chrono::steady_clock::now();
  for (int repeat = 0; repeat < measurement.repeats || std::chrono::steady_clock::now() - begun <
                                                           std::chrono::milliseconds(kLeastMilliseconds);
       ++repeat) {
    double operations = 0;
    const auto start = std::chrono::steady_clock::now();
#pragma omp parallel num_threads(measurement.settings.threads) reduction(+ : operations)
    operations += kernels.multiply_add_loop(kRounds);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    best = std::max(best, operations / seconds.count());
  }
  return best;
}

}  // namespace gld
