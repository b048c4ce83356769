#pragma once

#include "gld/flow/velocity_field.h"

#include <memory>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Stiff initial value problems dx/ds = f(x, s), s from 0 to its end, behind the interface of a flow: t = 1 - s/end, so
// velocity(x, t) = -end f(x, s). In double.
struct StiffProblem {
  std::string name;
  std::shared_ptr<VelocityField> field;
  torch::Tensor start;     // at t = 1
  torch::Tensor solution;  // at t = 0
  torch::Tensor scale;     // errors are measured in units of this, elementwise
};

//   prothero_robinson_1e2, _1e4, _1e6  x' = -L (x - cos s) - sin s to s = 10, whose solution is cos s
//                                      (Prothero and Robinson 1974)
//   linear                             x' = diag(-1, -1e3, -1e6) x to s = 1
//   van_der_pol                        mu = 1e3 in Hairer and Wanner's scaling (II, IV.10): to s = 2
//   rober                              Robertson's reaction to s = 40 (Hairer and Wanner II, IV.10)
//   narrow_mixture_1e-2, _1e-4         the flow to two Gaussians of width 1e-2, 1e-4 at -1 and 1; in one dimension the
//                                      flow keeps quantiles, which gives the solution
std::vector<StiffProblem> stiff_problems();

// Returns the RMS of (state - solution)/scale.
double stiff_error(const StiffProblem& problem, const torch::Tensor& state);

}  // namespace gld
