#pragma once

#include <cstdint>
#include <vector>

namespace gld {

struct MeanInterval {
  double low = 0;
  double high = 0;
};

constexpr int64_t kBootstrapResamples = 2000;

// The 95 % interval of a mean over scenes by the percentile bootstrap (Efron 1979): scenes are drawn with replacement
// as often as there are, and the 2.5th and 97.5th percentile of the resampled means are taken. Values that are not
// finite are left out; NaN with fewer than 2, which say nothing of how scenes differ. The same values and seed give the
// same interval.
MeanInterval bootstrap_mean_interval(const std::vector<double>& values, uint64_t seed = 0,
                                     int64_t resamples = kBootstrapResamples);

}  // namespace gld
