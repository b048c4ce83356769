#pragma once

#include "infer/method/sampling_method.h"
#include "models/bundle/bundle_options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// A way to sample, among others of its kind.
struct ComparedMethod {
  std::string family;  // "fewer evaluations", "encoder nodes", "euler, logsnr", ...: one line of the plot
  double guidance_scale = 1.5;
  SamplingMethod method;

  // Returns whether it is what all others are compared with at equal work: the default solver, nothing left out.
  bool is_fewer_evaluations() const;
  // Returns whether --tolerance may take it: other solvers than the default and the published one are there to be
  // looked at.
  bool is_offered() const;
};

// Returns the default solver with that many evaluations a level and nothing left out.
SamplingMethod plain_method(int64_t evaluations);

// Returns what a comparison has for one guidance scale: the published sampler; the default solver at each count; other
// solvers and the published grid at each count; encoder nodes; guidance on an interval where there is guidance; few
// evaluations, refined, where the model has a refiner of samples; and in each precision other than float32 the default
// solver at each count.
std::vector<ComparedMethod> compared_methods(const std::vector<int64_t>& counts,
                                             const std::vector<ComputePrecision>& precisions,
                                             double guidance_scale, const BundleOptions& bundle);

// Returns the methods of these families and all of "fewer evaluations"; these are all methods where families is empty.
// Throws Error for a family that no method is of.
std::vector<ComparedMethod> of_families(std::vector<ComparedMethod> methods,
                                        const std::vector<std::string>& families);

}  // namespace gld
