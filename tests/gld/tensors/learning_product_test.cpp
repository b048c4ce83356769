// Products that learn in a reduced precision, beside the products of operands that were rounded by LibTorch, in double.
#include "gld/tensors/learning_product.h"

#include "gld/tensors/torch_version.h"
#include "tests/support/error_of.h"

#include <limits>
#include <tuple>
#include <vector>

#include <torch/autograd.h>
#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

torch::Tensor rounded(const torch::Tensor& x) { return x.detach().to(torch::kBFloat16).to(torch::kFloat64); }

double relative_rms(const torch::Tensor& found, const torch::Tensor& expected) {
  EXPECT_EQ(found.sizes(), expected.sizes());
  return ((found.to(torch::kFloat64) - expected).norm() / expected.norm()).item<double>();
}

struct Case {
  torch::Tensor x, weight, bias, gradient;  // gradient: of the result

  Case(torch::IntArrayRef rows, int64_t inputs, int64_t outputs) {
    auto shape = rows.vec();
    shape.push_back(inputs);
    x = torch::randn(shape).requires_grad_(true);
    weight = torch::randn({outputs, inputs}).requires_grad_(true);
    bias = torch::randn({outputs}).requires_grad_(true);
    shape.back() = outputs;
    gradient = torch::randn(shape);
  }

  std::vector<torch::Tensor> gradients(ComputePrecision precision) const {
    const auto y = learning_product(x, weight, bias, precision);
    return torch::autograd::grad({y}, {x, weight, bias}, {gradient});
  }
};

TEST(LearningProduct, RoundsTheOperandsOfAllThreeProducts) {
  torch::manual_seed(1);
  for (const auto& [rows, inputs, outputs] : std::vector<std::tuple<std::vector<int64_t>, int64_t, int64_t>>{
           {{1}, 1, 1}, {{3}, 7, 5}, {{2, 33}, 48, 70}, {{4, 16, 5}, 161, 33}, {{700}, 96, 128}}) {
    const Case one(rows, inputs, outputs);
    const auto y = learning_product(one.x, one.weight, one.bias, ComputePrecision::kBFloat16);
    EXPECT_EQ(y.scalar_type(), torch::kFloat32);
    const auto x = rounded(one.x), weight = rounded(one.weight), gradient = rounded(one.gradient);
    const auto flat_x = x.reshape({-1, inputs}), flat_gradient = gradient.reshape({-1, outputs});
    EXPECT_LT(relative_rms(y, torch::matmul(x, weight.t()) + one.bias.detach().to(torch::kFloat64)), 1e-6);
    const auto found = one.gradients(ComputePrecision::kBFloat16);
    EXPECT_LT(relative_rms(found[0], torch::matmul(gradient, weight)), 1e-6);
    EXPECT_LT(relative_rms(found[1], torch::mm(flat_gradient.t(), flat_x)), 1e-6);
    // The bias's gradient is a sum of what was not rounded.
    EXPECT_LT(relative_rms(found[2], one.gradient.to(torch::kFloat64).reshape({-1, outputs}).sum(0)), 1e-6);
  }
}

TEST(LearningProduct, GivesGradientsToWhatWantsThemAlone) {
  torch::manual_seed(3);
  const Case one({50}, 40, 30);
  const auto whole = one.gradients(ComputePrecision::kBFloat16);
  const auto frozen = one.weight.detach();
  const auto y = learning_product(one.x, frozen, {}, ComputePrecision::kBFloat16);
  EXPECT_TRUE(torch::equal(torch::autograd::grad({y}, {one.x}, {one.gradient})[0], whole[0]));
  const auto z = learning_product(one.x.detach(), one.weight, one.bias.detach(), ComputePrecision::kBFloat16);
  EXPECT_TRUE(torch::equal(torch::autograd::grad({z}, {one.weight}, {one.gradient})[0], whole[1]));
}

TEST(LearningProduct, GivesTheSameBitsForAnyNumberOfThreads) {
  torch::manual_seed(4);
  const Case one({300}, 96, 200);
  const int before = thread_count();
  set_thread_count(1);
  const auto expected = one.gradients(ComputePrecision::kBFloat16);
  set_thread_count(2);
  const auto found = one.gradients(ComputePrecision::kBFloat16);
  set_thread_count(before);
  for (size_t i = 0; i < expected.size(); ++i) EXPECT_TRUE(torch::equal(found[i], expected[i]));
}

// A step whose numbers overflowed has to be seen by who skips it.
TEST(LearningProduct, CarriesWhatIsNotFinite) {
  torch::manual_seed(5);
  Case one({60}, 40, 30);
  {
    const torch::NoGradGuard no_grad;
    one.x.index_put_({7, 3}, std::numeric_limits<float>::quiet_NaN());
  }
  const auto y = learning_product(one.x, one.weight, one.bias, ComputePrecision::kBFloat16);
  EXPECT_TRUE(y[7].isnan().all().item<bool>());
  EXPECT_TRUE(one.gradients(ComputePrecision::kBFloat16)[1].select(1, 3).isnan().all().item<bool>());
}

TEST(LearningProduct, RefusesWhatItDoesNotCompute) {
  const Case one({50}, 40, 30);
  EXPECT_EQ(test::error_of([&] { one.gradients(ComputePrecision::kInt8); }),
            "learning product: expected bfloat16, found int8; train in float32 or bfloat16.");
  const auto y = learning_product(one.x, one.weight, one.bias, ComputePrecision::kBFloat16);
  EXPECT_EQ(
      test::error_of([&] {
        torch::autograd::grad({y}, {one.x}, {one.gradient}, /*retain_graph=*/true, /*create_graph=*/true);
      }),
      "learning product: expected first derivatives only, found a backward pass that records a graph of its "
      "own; compute in float32.");
}

}  // namespace
}  // namespace gld
