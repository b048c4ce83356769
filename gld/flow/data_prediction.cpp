#include "gld/flow/data_prediction.h"

#include <cmath>
#include <cstddef>

#include <Eigen/LU>

namespace gld {
namespace {

double log_snr(double t) { return std::log((1 - t) / t); }

// moments[k] = h * integral over y from -1 to 0 of exp(h y) y^k.
std::vector<double> exponential_moments(double h, size_t count) {
  std::vector<double> moments(count);
  for (size_t k = 0; k < count; ++k) {
    const double order = static_cast<double>(k), sign = k % 2 == 0 ? 1 : -1;
    if (h < 2) {
      // This takes the series of exp: the recursion below cancels for small h.
      double term = sign * h, sum = 0;
      for (int n = 0; n < 40; ++n) {
        sum += term / (n + order + 1);
        term *= -h / (n + 1);
      }
      moments[k] = sum;
    } else {
      moments[k] = k == 0 ? -std::expm1(-h) : -sign * std::exp(-h) - order / h * moments[k - 1];
    }
  }
  return moments;
}

// Returns the weights w with sum_j w_j y_j^k = moments[k]: the integral of the polynomial through values at y_j.
std::vector<double> weights_for_moments(const std::vector<double>& y, const std::vector<double>& moments) {
  const auto n = static_cast<Eigen::Index>(y.size());
  Eigen::MatrixXd powers(n, n);
  Eigen::VectorXd right(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    right(k) = moments[static_cast<size_t>(k)];
    for (Eigen::Index j = 0; j < n; ++j) {
      powers(k, j) = std::pow(y[static_cast<size_t>(j)], static_cast<double>(k));
    }
  }
  const Eigen::VectorXd solution = powers.fullPivLu().solve(right);
  return {solution.data(), solution.data() + n};
}

// A step that starts at t = 1, where rho = 0 and the weight of D over rho is constant: linear in rho through the
// start and, for a corrector, the end.
std::vector<double> weights_from_noise(double next, const std::vector<double>& nodes) {
  std::vector<double> weights(nodes.size(), 0.0);
  double others = 0;
  for (size_t j = 0; j < nodes.size(); ++j) {
    if (nodes[j] == next) others = weights[j] = (1 - next) / 2;
  }
  for (size_t j = 0; j < nodes.size(); ++j) {
    if (nodes[j] == 1) weights[j] = 1 - next - others;
  }
  return weights;
}

}  // namespace

std::vector<double> data_prediction_weights(double start, double next, const std::vector<double>& nodes) {
  if (start >= 1) return weights_from_noise(next, nodes);
  if (next <= 0) {
    std::vector<double> w(nodes.size(), 0.0);
    w[0] = 1;
    return w;
  }
  const double h = log_snr(next) - log_snr(start);
  std::vector<double> y;
  std::vector<size_t> kept;
  for (size_t j = 0; j < nodes.size(); ++j) {
    if (nodes[j] >= 1) continue;
    kept.push_back(j);
    y.push_back((log_snr(nodes[j]) - log_snr(next)) / h);
  }
  const auto inner = weights_for_moments(y, exponential_moments(h, y.size()));
  std::vector<double> weights(nodes.size(), 0.0);
  for (size_t j = 0; j < kept.size(); ++j) weights[kept[j]] = (1 - next) * inner[j];
  return weights;
}

std::vector<double> dpm_solver_2m_weights(double start, double next, double previous) {
  const double first_order = 1 - next / start;
  if (previous >= 1 || next <= 0) return {first_order, 0};
  const double ratio = (log_snr(start) - log_snr(previous)) / (log_snr(next) - log_snr(start));
  return {first_order * (1 + 1 / (2 * ratio)), -first_order / (2 * ratio)};
}

}  // namespace gld
