#pragma once

#include "bench/sampling/sampling_methods.h"
#include "gld/report/plot.h"
#include "gld/report/table.h"

#include <algorithm>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// Returns the largest; NaN where one is.
double worst_error(const std::map<int64_t, double>& level_errors);

// One scene sampled one way.
struct Sample {
  std::string scene;
  int64_t evaluations = 0;    // of all flows together
  int64_t unconditional = 0;  // of them with the unconditional branch
  // By generated level: RMS of the latent's difference from the reference over the reference's RMS, in tables
  // level1_error and so on; 0 of a reference, NaN where sampling stopped at a value that was not finite.
  std::map<int64_t, double> level_errors;
  double precision_error = 0;  // the worst level's against the same method in float32; 0 in float32
  // Every metric of images by its name, means over the target views; one that is absent is left out.
  std::map<std::string, double> quality;
  double psnr_to_reference = 0;  // of its images against the reference's, in dB
  double flop = 0;               // of M1 and the cascade, from what ran
  double seconds = 0;            // of M1 and the cascade, beside the other workers
  int64_t peak_bytes = 0;        // largest resident memory of a stage
  int64_t non_finite = 0;        // 1 where sampling stopped at a value that was not finite

  double error() const;                                // the worst level's; NaN where one is
  double quality_of(const std::string& metric) const;  // NaN where absent
};

// A way to sample, over all scenes.
struct MethodRow {
  ComparedMethod compared;
  std::vector<Sample> samples;
  Sample mean;  // of every number; peak_bytes is the largest and non_finite the sum
  double mean_error = 0;
  double largest_error = 0;
  double psnr_difference = 0;  // mean, from the reference's PSNR; NaN without a truth
  // Of M1 and the cascade, of one scene alone on all threads; the shortest of the repeats.
  double seconds = 0;
  int64_t peak_bytes = 0;  // the largest of the repeats
  // Error of the default solver with as many evaluations as the same operations, or the same seconds, pay for; 0 where
  // it is that itself. Another precision has the operations of float32: it is compared by seconds alone.
  double error_at_equal_flop = 0;
  double error_at_equal_seconds = 0;
  // On the Pareto front of seconds and mean error, or of seconds and PSNR, among the rows of its guidance scale.
  bool on_error_front = false;
  bool on_quality_front = false;

  bool finite() const { return mean.non_finite == 0; }
};

// Returns the error at a cost between (or beyond) measured points (cost, error): straight lines in the logarithms of
// both. There are at least two points, of different cost.
double error_at_cost(std::vector<std::pair<double, double>> points, double cost);

// Fills in means, comparisons with "fewer evaluations" and fronts from the samples and the timing of every row.
// references has for each guidance scale what errors refer to, one sample a scene in the same order.
void summarise(std::vector<MethodRow>& rows, const std::map<double, std::vector<Sample>>& references);

// The table has every sample, those of the references first.
Table sample_table(const std::vector<MethodRow>& rows,
                   const std::map<double, std::vector<Sample>>& references);
Table method_table(const std::vector<MethodRow>& rows);  // one line a method, with who wins at equal cost
// Returns what precisions other than float32 differ from it by, with the same method and noise; empty without any.
std::string precisions_text(const std::vector<MethodRow>& rows);
Figure sample_figure(const std::vector<MethodRow>& rows, double guidance_scale);

// How often the error bound of one half of the scenes held on the other half, over all methods and both halves.
struct BoundCheck {
  int64_t samples = 0;
  int64_t exceeded = 0;
};
BoundCheck check_bounds(const std::vector<MethodRow>& rows);

}  // namespace gld
