#pragma once

#include "gld/base/bootstrap.h"

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace gld {

// Numbers of one metric by seed and scene. Held in order, so that no result depends on the order they were measured in.
using NumbersBySeed = std::map<int64_t, std::map<std::string, double>>;

// Returns the number of scenes that have a number of at least one seed.
int64_t scene_count(const NumbersBySeed& numbers);

// Returns the mean over seeds of the means over their scenes; NaN without numbers.
double mean_of_seed_means(const NumbersBySeed& numbers);

// Returns the interval of mean_of_seed_means and whether it is 0 (gld/base/bootstrap.h). A verdict also asks that seeds
// agree (verdict.h).
BootstrapTest test_of_seed_means(const NumbersBySeed& numbers, const BootstrapOptions& options = {});

// Returns the two-sided p-value of "the mean over seeds is 0" by Student's t-test of the seeds' means; 1 with fewer
// than two. The replicates above draw seeds that all have one sign and have one sign themselves: with three trainings
// that differ as much as scenes do they are below 0.05 in one of five cases where there is nothing; this test is not.
double seed_means_p_value(const NumbersBySeed& numbers);

// Returns p-values of several claims at once by Holm (1979): the smallest times their number, the next times one less,
// and so on, none smaller than the one before, and at most 1. Where claims are believed below 0.05, one table in twenty
// at most has one that is believed wrongly, as far as the p-values are right. They are in the order given.
std::vector<double> holm_p_values(const std::vector<double>& p_values);

// The exact two-sided binomial test of "positive and negative are equally likely". Each scene counts once, with the
// sign of its mean over seeds; ties are left out.
struct SignTest {
  int64_t positive = 0;
  int64_t negative = 0;
  int64_t ties = 0;
  double p_value = 1;
};
SignTest sign_test(const NumbersBySeed& differences);

// Returns min(1, 2 P(X <= min(positive, negative))) of X ~ Binomial(positive + negative, 1/2).
double sign_test_p_value(int64_t positive, int64_t negative);

}  // namespace gld
