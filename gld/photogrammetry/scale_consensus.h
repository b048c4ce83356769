#pragma once

#include "gld/photogrammetry/depth_scale.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace gld {

// Scales that are weighed against each other, evenly spaced in their logarithm.
struct ScaleCandidates {
  double log_first = 0;
  double log_step = 0.06;
  int64_t count = 1;
  // Scales beyond the ends are possible too: what then is best at an end says only that the scale lies there or beyond.
  bool cut_off = false;

  // Candidates go from lowest to highest, both > 0.
  static ScaleCandidates between(double lowest, double highest);
  double log_scale(double index) const { return log_first + index * log_step; }
};

// Which part of a view an observation is of. Observations of one block are likely to be wrong together, and those of
// one view to be off together.
struct ObservedPart {
  size_t view = 0;
  size_t block = 0;
};

// Finds the one scale that many noisy observations of log(true depth / predicted depth) agree on, some of which are
// wrong altogether. An observation is a density over the candidates; predicted depth is believed to be off by some
// 12 % from point to point, so that each is blurred by as much. With half of the observations believed to be wrong the
// likelihood of a scale s is sum_i log(1/2 + 1/2 n density_i(s)), n candidates: a wrong observation costs a constant.
//
// A model's depth also has an error that a whole view shares. So the maximum over all observations only says where to
// look; near it every view has a maximum of its own, and the scale is their mean, weighted by what resampled blocks and
// the scatter between the views say of their precision (DerSimonian and Laird 1986, random effects).
class ScaleConsensus {
 public:
  explicit ScaleConsensus(const ScaleCandidates& candidates);

  const ScaleCandidates& candidates() const { return candidates_; }

  // density has one value >= 0 a candidate, not all 0; its sum does not matter.
  void add(const std::vector<float>& density, const ObservedPart& part);
  // Adds an observation of exactly this ratio; one outside the candidates counts as wrong.
  void add_ratio(double ratio, const ObservedPart& part);

  int64_t observations() const { return observations_; }

  // Returns nothing of fewer than 20 observations or 2 blocks, and where the best of candidates that are cut off lies
  // at an end. The interval covers where the maximum lies when blocks are drawn anew (bootstrap, always with the same
  // draws) and the scatter between views, and is never narrower than smallest_deviation (of the logarithm) allows. The
  // residual is the median of |log(ratio / scale)| over the observations that are decided by themselves.
  std::optional<DepthScale> estimate(const std::string& estimator, double smallest_deviation) const;

 private:
  using Likelihood = std::vector<double>;  // the logarithm, of each candidate
  struct Block {
    size_t view = 0;
    size_t number = 0;
    Likelihood likelihood;
  };
  Likelihood& likelihood_of(const ObservedPart& part);
  void add_blurred(const std::vector<double>& blurred, const ObservedPart& part);

  ScaleCandidates candidates_;
  std::vector<double> kernel_;  // of the blur, odd length, sum 1
  std::vector<Block> blocks_;
  std::vector<double> decided_;  // log ratio of each observation that is decided
  int64_t observations_ = 0;
};

}  // namespace gld
