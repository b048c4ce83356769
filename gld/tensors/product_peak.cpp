#include "gld/tensors/product_peak.h"

#include <algorithm>
#include <chrono>

#include <torch/types.h>

namespace gld {

double measure_sgemm_peak() {
  constexpr int64_t kSize = 1024;
  constexpr int kRepeats = 5;
  const torch::NoGradGuard no_grad;
  const auto a = torch::ones({kSize, kSize});
  const auto b = torch::ones({kSize, kSize});
  auto c = torch::mm(a, b);
  double best = 0;
  for (int repeat = 0; repeat < kRepeats; ++repeat) {
    const auto start = std::chrono::steady_clock::now();
    torch::mm_out(c, a, b);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    best = std::max(best, 2.0 * kSize * kSize * kSize / seconds.count());
  }
  return best;
}

}  // namespace gld
