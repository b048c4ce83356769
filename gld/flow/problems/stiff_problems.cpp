#include "gld/flow/problems/stiff_problems.h"

#include "gld/flow/problems/exact_flows.h"

#include <cmath>
#include <functional>
#include <utility>

namespace gld {
namespace {

using Values = std::vector<double>;

torch::Tensor tensor_of(const Values& values) { return torch::tensor(values, torch::kFloat64); }

// An equation in small vectors of doubles.
class EquationField : public VelocityField {
 public:
  using Slope = std::function<Values(const double* x, double s)>;
  EquationField(double end, Slope slope) : end_(end), slope_(std::move(slope)) {}

  torch::Tensor velocity(const torch::Tensor& state, double t) override {
    const auto x = state.to(torch::kFloat64).contiguous();
    Values slope = slope_(x.data_ptr<double>(), end_ * (1 - t));
    for (double& value : slope) value *= -end_;
    return tensor_of(slope).view(state.sizes()).to(state.scalar_type());
  }

 private:
  double end_;
  Slope slope_;
};

StiffProblem equation(const std::string& name, double end, EquationField::Slope slope, const Values& start,
                      const Values& solution, const Values& scale) {
  return {name, std::make_shared<EquationField>(end, std::move(slope)), tensor_of(start), tensor_of(solution),
          tensor_of(scale)};
}

StiffProblem prothero_robinson(double stiffness, const std::string& suffix) {
  constexpr double kEnd = 10;
  const auto slope = [stiffness](const double* x, double s) {
    return Values{-stiffness * (x[0] - std::cos(s)) - std::sin(s)};
  };
  return equation("prothero_robinson_" + suffix, kEnd, slope, {1}, {std::cos(kEnd)}, {1});
}

double normal_cumulative(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

// Returns the point below which two Gaussians at -1 and 1 hold the fraction that the normal distribution holds below
// x < 0.
double negative_quantile(double x, double width) {
  const double target = normal_cumulative(x);
  double low = -1 - 40 * width, high = 0;
  for (int i = 0; i < 200; ++i) {
    const double middle = 0.5 * (low + high);
    const double held =
        0.5 * (normal_cumulative((middle + 1) / width) + normal_cumulative((middle - 1) / width));
    (held < target ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

StiffProblem narrow_mixture(double width, const std::string& suffix) {
  GaussianMixture mixture{tensor_of({-1, 1}).view({2, 1}),
                          tensor_of({width * width, width * width}).view({2, 1}), tensor_of({1, 1})};
  Values noise, solution;
  for (const double x : {-2.5, -1.7, -1.1, -0.6, -0.2, 0.2, 0.6, 1.1, 1.7, 2.5}) {
    noise.push_back(x);
    solution.push_back(x < 0 ? negative_quantile(x, width) : -negative_quantile(-x, width));
  }
  const auto count = static_cast<int64_t>(noise.size());
  return {"narrow_mixture_" + suffix, std::make_shared<MixtureField>(mixture),
          tensor_of(noise).view({count, 1}), tensor_of(solution).view({count, 1}),
          torch::ones({1}, torch::kFloat64)};
}

}  // namespace

std::vector<StiffProblem> stiff_problems() {
  std::vector<StiffProblem> problems{prothero_robinson(1e2, "1e2"), prothero_robinson(1e4, "1e4"),
                                     prothero_robinson(1e6, "1e6")};
  problems.push_back(equation("linear", 1,
                              [](const double* x, double) {
                                return Values{-x[0], -1e3 * x[1], -1e6 * x[2]};
                              },
                              {1, 1, 1}, {std::exp(-1.0), 0, 0}, {1, 1, 1}));
  // The solution is that of Test Set for Initial Value Problem Solvers, problem vdpol.
  const Values van_der_pol{1.706167732170469, -0.8928097010248125};
  problems.push_back(equation(
      "van_der_pol", 2,
      [](const double* x, double) {
        return Values{x[1], ((1 - x[0] * x[0]) * x[1] - x[0]) / 1e-6};
      },
      {2, 0}, van_der_pol, van_der_pol));
  // The solution is that of our rodas3 at tolerance 1e-11, which agrees with the four digits that SUNDIALS prints at
  // s = 40.
  const Values rober{0.7158270687193941, 9.185534764558135e-6, 0.2841637457458413};
  problems.push_back(equation(
      "rober", 40,
      [](const double* x, double) {
        const double forward = 0.04 * x[0], back = 1e4 * x[1] * x[2], fast = 3e7 * x[1] * x[1];
        return Values{-forward + back, forward - back - fast, fast};
      },
      {1, 0, 0}, rober, rober));
  problems.push_back(narrow_mixture(1e-2, "1e-2"));
  problems.push_back(narrow_mixture(1e-4, "1e-4"));
  return problems;
}

double stiff_error(const StiffProblem& problem, const torch::Tensor& state) {
  return ((state.to(torch::kFloat64) - problem.solution) / problem.scale)
      .square()
      .mean()
      .sqrt()
      .item<double>();
}

}  // namespace gld
