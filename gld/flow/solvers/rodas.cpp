#include "gld/base/error.h"
#include "gld/flow/solvers/solver_run.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <Eigen/LU>

namespace gld {
namespace {

// Sandu et al. 1997, "Benchmarking stiff ODE solvers for atmospheric chemistry problems II": RODAS3, order 3(2),
// L-stable and stiffly accurate, in the form that needs no product with the Jacobian. Times run down here, so the
// equation is dx/ds = f(x, s) = -velocity(x, 1 - s).
constexpr int kStages = 4;
constexpr double kGamma = 0.5;
constexpr double kA[kStages][kStages] = {{0, 0, 0, 0}, {0, 0, 0, 0}, {2, 0, 0, 0}, {2, 0, 1, 0}};
constexpr double kC[kStages][kStages] = {{0, 0, 0, 0}, {4, 0, 0, 0}, {1, -1, 0, 0}, {1, -1, -8.0 / 3, 0}};
constexpr double kNodes[kStages] = {0, 0, 1, 1};
constexpr double kGammas[kStages] = {0.5, 1.5, 0, 0};
constexpr bool kNewEvaluation[kStages] = {true, false, true, true};
constexpr double kSolution[kStages] = {2, 0, 1, 1};
constexpr double kError[kStages] = {0, 0, 0, 1};
constexpr int64_t kLargestSystem = 512;

using Vector = Eigen::VectorXd;

// f as a function of flat vectors.
class FlatField {
 public:
  explicit FlatField(SolverRun& run) : run_(run), like_(run.report().state) {}

  Vector slope(const Vector& x, double time) {
    const auto v = run_.velocity(tensor(x), time).to(torch::kFloat64).reshape({-1}).contiguous();
    return -Eigen::Map<const Vector>(v.data_ptr<double>(), v.numel());
  }
  torch::Tensor tensor(const Vector& x) const {
    auto flat = torch::empty({x.size()}, torch::kFloat64);
    std::copy(x.data(), x.data() + x.size(), flat.data_ptr<double>());
    return flat.view(like_.sizes()).to(like_.dtype());
  }
  Vector vector() const {
    const auto x = like_.to(torch::kFloat64).reshape({-1}).contiguous();
    return Eigen::Map<const Vector>(x.data_ptr<double>(), x.numel());
  }

 private:
  SolverRun& run_;
  torch::Tensor like_;
};

// Takes forward differences, with one evaluation a column.
Eigen::MatrixXd jacobian(FlatField& field, const Vector& x, const Vector& slope, double time) {
  const double root = std::sqrt(std::numeric_limits<double>::epsilon());
  Eigen::MatrixXd result(x.size(), x.size());
  for (Eigen::Index j = 0; j < x.size(); ++j) {
    Vector moved = x;
    moved(j) += root * std::max(std::abs(x(j)), 1e-5);
    const double step = moved(j) - x(j);
    result.col(j) = (field.slope(moved, time) - slope) / step;
  }
  return result;
}

Vector time_derivative(FlatField& field, const Vector& x, const Vector& slope, double time) {
  const double step = std::sqrt(std::numeric_limits<double>::epsilon());
  const double other = time > step ? time - step : time + step;
  return (field.slope(x, other) - slope) / (time - other);
}

}  // namespace

void run_rodas3(SolverRun& run, const std::vector<double>& times) {
  FlatField field(run);
  Vector x = field.vector();
  if (x.size() > kLargestSystem) {
    fail({"solver rodas3", "at most " + std::to_string(kLargestSystem) + " unknowns",
          std::to_string(x.size()), "use dp54 or a fixed-step solver for larger states"});
  }
  const double last = times.back(), tolerance = run.options().tolerance;
  double time = times.front(), h = std::min(1e-6, time - last);
  const Eigen::MatrixXd identity = Eigen::MatrixXd::Identity(x.size(), x.size());
  while (time > last) {
    const Vector slope = field.slope(x, time);
    const Eigen::MatrixXd matrix = jacobian(field, x, slope, time);
    const Vector in_time = time_derivative(field, x, slope, time);
    for (bool accepted = false; !accepted;) {
      const bool final_step = h >= (time - last) * (1 - 1e-12);
      if (final_step) h = time - last;
      if (!(time - h < time)) run.give_up(SolveFailureKind::kStepTooSmall, "step", time);
      const Eigen::PartialPivLU<Eigen::MatrixXd> solver(identity / (h * kGamma) - matrix);
      std::vector<Vector> k(kStages);
      Vector f = slope, next = x, error = Vector::Zero(x.size());
      for (int i = 0; i < kStages; ++i) {
        const double stage_time = kNodes[i] == 1 ? (final_step ? last : time - h) : time;
        if (i > 0 && kNewEvaluation[i]) {
          Vector state = x;
          for (int j = 0; j < i; ++j) state += kA[i][j] * k[static_cast<size_t>(j)];
          f = field.slope(state, stage_time);
        }
        Vector right = f + (kGammas[i] * h) * in_time;
        for (int j = 0; j < i; ++j) right += (kC[i][j] / h) * k[static_cast<size_t>(j)];
        k[static_cast<size_t>(i)] = solver.solve(right);
        next += kSolution[i] * k[static_cast<size_t>(i)];
        error += kError[i] * k[static_cast<size_t>(i)];
      }
      // Small unknowns beside large ones matter in stiff problems, so the absolute part is a thousandth here.
      const Eigen::ArrayXd scale = tolerance * (1e-3 + x.array().abs().max(next.array().abs()));
      const double size = std::sqrt((error.array() / scale).square().mean());
      accepted = size <= 1;
      if (accepted) {
        time = final_step ? last : time - h;
        x = next;
        run.accept(field.tensor(x), time);
      } else {
        run.reject();
      }
      h *= std::isfinite(size)
               ? std::clamp(0.9 * std::pow(std::max(size, 1e-10), -1.0 / 3), 0.1, accepted ? 5.0 : 0.9)
               : 0.1;
    }
  }
}

}  // namespace gld
