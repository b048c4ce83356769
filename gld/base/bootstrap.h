#pragma once

#include <cstdint>
#include <vector>

namespace gld {

struct Interval {
  double low = 0;
  double high = 0;
};

struct BootstrapOptions {
  int64_t replicates = 10'000;
  double coverage = 0.95;
  uint64_t seed = 1;
};

// Returns the percentile interval of the mean over seeds of the means over scenes by the hierarchical bootstrap: each
// replicate draws seeds, then scenes. Rows are seeds, columns are the scenes that all of them share; NaN stands where a
// seed has no number of a scene. With one seed it is Efron's (1979) of a mean over scenes. The scenes are drawn once a
// replicate and stand for all of its seeds, because the same scenes were measured under every seed (Owen 2007, "The
// pigeonhole bootstrap"): scenes drawn anew under each seed would count a scene's difficulty as independent evidence
// once a seed, and the interval would be too narrow by up to the root of the number of seeds. With as few seeds as
// three the interval covers less than its name says where seeds differ more than scenes. The same numbers and options
// give the same interval; it is NaN without numbers.
Interval bootstrap_interval(const std::vector<std::vector<double>>& numbers,
                            const BootstrapOptions& options = {});

// The same with the two-sided p-value of "the mean is 0": twice the share of replicates on the rarer side of 0, the
// numbers themselves counted as one replicate more (Davison and Hinkley 1997, 4.2), so that it is never below
// 2 / (replicates + 1); at most 1, which it is without numbers. Below 1 - coverage where the interval leaves 0 out, but
// for the last replicate.
struct BootstrapTest {
  Interval interval;
  double p_value = 1;
};
BootstrapTest bootstrap_test(const std::vector<std::vector<double>>& numbers,
                             const BootstrapOptions& options = {});

}  // namespace gld
