#pragma once

#include <vector>

namespace gld {

// Exponential integration of the linear path in data prediction. With D(x, t) = x - t v and rho = (1 - t)/t, the flow
// is d(x/t)/d rho = D, so one step is exactly
//   x_t = (t/s) x_s + t * integral of D over rho from rho_s to rho_t,
// and replacing D by a polynomial in the log-SNR lambda = log rho through known values gives
//   x_t = (t/s) x_s + sum_j w_j D_j with sum_j w_j = 1 - t/s.
// (Lu et al. 2022, DPM-Solver++, equation 9, for alpha = 1 - t, sigma = t.)

// Returns the weights w_j for a step from `start` to `next` and values D_j at the flow times `nodes`, all different.
// The limits at both ends are exact: a node at t = 1 (log-SNR minus infinity) drops out of the polynomial unless the
// step starts there, in which case D is linear in rho; a step to t = 0, where x is D itself, takes the first node's
// D as it is.
std::vector<double> data_prediction_weights(double start, double next, const std::vector<double>& nodes);

// Returns DPM-Solver++(2M)'s own second-order weights: the difference quotient enters with one half of the first-order
// weight. previous is the flow time of the step before.
std::vector<double> dpm_solver_2m_weights(double start, double next, double previous);

}  // namespace gld
