#pragma once

#include "gld/report/plot.h"
#include "gld/report/table.h"
#include "infer/method/sampling_method.h"
#include "models/bundle/bundle_options.h"

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// A way to sample, among others of its kind.
struct PlanVariant {
  std::string family;  // "fewer evaluations", "encoder nodes", ...: one line of the plot
  SamplingMethod method;
};

// The default solver with that many evaluations a level and no approximation.
SamplingMethod exact_method(int64_t evaluations);

// The published sampler; the default solver at each count; at 16 evaluations, encoder nodes, encoder reuse, guidance on
// an interval or dropped, visible pairs; nodes at other counts; balanced and fast.
std::vector<PlanVariant> plan_variants(const std::vector<int64_t>& counts, const BundleOptions& bundle);

// The default solver at each count, balanced and fast in that precision: one family, named like the precision.
std::vector<PlanVariant> precision_variants(const std::vector<int64_t>& counts, const BundleOptions& bundle,
                                            ComputePrecision precision);

// The variants of these families and all of "fewer evaluations"; all where families is empty. Throws Error for a family
// that no variant is of.
std::vector<PlanVariant> of_families(std::vector<PlanVariant> variants,
                                     const std::vector<std::string>& families);

// One scene sampled one way.
struct PlanSample {
  std::string scene;
  // RMS of the latent's difference from the reference, over the reference's RMS, of the boundary level and of the
  // shallowest one; in tables level1_error and level0_error, what they are of the published model.
  double boundary_error = 0;
  double shallowest_error = 0;
  double precision_error = 0;    // the worse of both against the same method in float32; 0 in float32
  double psnr = 0;               // of the target views in dB
  double psnr_difference = 0;    // from the reference's psnr
  double psnr_to_reference = 0;  // of its images against the reference's
  double flop = 0;               // of M1 and the cascade, from what ran

  double error() const { return std::max(shallowest_error, boundary_error); }
};

// A way to sample, over all scenes.
struct PlanRow {
  PlanVariant variant;
  std::vector<PlanSample> samples;
  double mean_error = 0;  // of PlanSample::error
  double largest_error = 0;
  double psnr = 0;  // means
  double psnr_difference = 0;
  double psnr_to_reference = 0;
  double flop = 0;
  // Of M1 and the cascade, of one scene alone on all threads; the shortest of the repeats.
  double seconds = 0;
  int64_t peak_bytes = 0;  // the largest of the repeats
  // Error of the default solver with as many evaluations as the same flop pay for; 0 where it is that itself, or in
  // another precision, which saves time and not work.
  double error_of_fewer_evaluations = 0;
};

// The error at a flop between (or beyond) measured points (flop, error): straight lines in the logarithms of both.
// points: at least two, of different flop.
double error_at_flop(std::vector<std::pair<double, double>> points, double flop);

// Means, and the comparison at equal flop with the rows of the family "fewer evaluations".
void summarise(std::vector<PlanRow>& rows);

Table plan_sample_table(const std::vector<PlanRow>& rows);  // every sample
Table plan_row_table(const std::vector<PlanRow>& rows);     // one line a method, with who wins at equal flop
Figure plan_figure(const std::vector<PlanRow>& rows);       // error and quality against work and time

// How often the error bound of one half of the scenes held on the other half, over all methods and both halves.
struct BoundCheck {
  int64_t samples = 0;
  int64_t exceeded = 0;
};
BoundCheck check_bounds(const std::vector<PlanRow>& rows);

}  // namespace gld
