#include "bench/support/peak_meter.h"

#include "gld/kernels/multiply_add_peak.h"
#include "gld/tensors/product_peak.h"
#include "gld/tensors/torch_version.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {

void PeakMeter::measure(int threads) {
  PeakMeasurement measurement;
  measurement.settings.threads = threads;
  double& peak = peaks_[threads];
  peak = std::max(peak, measure_multiply_add_peak(measurement));
}

void PeakMeter::measure_with_product() {
  const int threads = thread_count();
  measure(threads);
  const double rate = measure_sgemm_peak();
  product_ = std::max(product_, rate);
  reached("a large matrix product", rate, 1, threads);
}

double PeakMeter::peak(int threads) const {
  const auto found = peaks_.find(threads);
  return found == peaks_.end() ? 0 : found->second;
}

void PeakMeter::reached(const std::string& what, double operations, double seconds, int threads) {
  const double rate = operations / seconds;
  Fastest& fastest = fastest_[threads];
  if (rate > fastest.rate) fastest = {what, rate};
}

std::vector<std::string> PeakMeter::problems() const {
  std::vector<std::string> sentences;
  for (const auto& [threads, fastest] : fastest_) {
    if (fastest.rate <= peak(threads)) continue;
    sentences.push_back(fmt::format(
        "The multiply-add peak was measured as {:.1f} GFLOP/s with {} thread{}, and {} reached {:.1f} in the same run: "
        "the peak was missed, and no fraction of it counts. Run this again on an idle machine.",
        peak(threads) * 1e-9, threads, threads == 1 ? "" : "s", fastest.what, fastest.rate * 1e-9));
  }
  return sentences;
}

}  // namespace gld
