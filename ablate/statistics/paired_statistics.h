#pragma once

#include <cstdint>
#include <map>
#include <string>

namespace gld {

// Numbers of one metric by seed and scene. Held in order, so that no result depends on the order they were measured in.
using NumbersBySeed = std::map<int64_t, std::map<std::string, double>>;

// first - second wherever both have a finite number of the same seed and scene; seeds without any are left out.
NumbersBySeed paired_differences(const NumbersBySeed& first, const NumbersBySeed& second);

// Scenes that have a number of at least one seed.
int64_t scene_count(const NumbersBySeed& numbers);

// The mean over seeds of the means over their scenes; NaN without numbers.
double mean_of_seed_means(const NumbersBySeed& numbers);

struct Interval {
  double low = 0;
  double high = 0;
};

struct BootstrapOptions {
  int64_t replicates = 10'000;
  double coverage = 0.95;
  uint64_t seed = 1;
};

// Percentile interval of mean_of_seed_means by the hierarchical bootstrap: each replicate draws seeds, then scenes. The
// scenes are drawn once a replicate and stand for all of its seeds, because the same scenes were measured under every
// seed (Owen 2007, "The pigeonhole bootstrap"): scenes drawn anew under each seed would count a scene's difficulty as
// independent evidence once a seed, and the interval would be too narrow by up to the root of the number of seeds. With
// as few seeds as three the interval covers less than its name says where seeds differ more than scenes; a verdict
// therefore also asks that seeds agree (verdict.h). NaN without numbers.
Interval bootstrap_interval(const NumbersBySeed& numbers, const BootstrapOptions& options = {});

// The exact two-sided binomial test of "positive and negative are equally likely". Each scene counts once, with the
// sign of its mean over seeds; ties are left out.
struct SignTest {
  int64_t positive = 0;
  int64_t negative = 0;
  int64_t ties = 0;
  double p_value = 1;
};
SignTest sign_test(const NumbersBySeed& differences);

// min(1, 2 P(X <= min(positive, negative))) of X ~ Binomial(positive + negative, 1/2).
double sign_test_p_value(int64_t positive, int64_t negative);

}  // namespace gld
