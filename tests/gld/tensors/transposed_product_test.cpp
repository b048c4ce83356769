#include "gld/tensors/transposed_product.h"

#include "gld/tensors/torch_version.h"

#include <cmath>
#include <cstdint>
#include <vector>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

struct Shape {
  int64_t rows, inputs, outputs;
};

// The shapes are on both sides of what is packed; 39 and 51 rows are what the statistics of three views multiply (a
// class token and 12 or 16 patches each).
std::vector<Shape> shapes() {
  return {{1, 1, 1},    {1, 512, 300}, {17, 5, 40},   {39, 588, 32},  {39, 32, 96},
          {47, 64, 64}, {48, 31, 200}, {51, 588, 96}, {130, 64, 257}, {600, 7, 48}};
}

// What several processes compute is the same bits as one computes only if no product depends on the number of threads.
TEST(TransposedProduct, GivesTheSameBitsForAnyNumberOfThreads) {
  const torch::NoGradGuard no_grad;
  const int before = thread_count();
  torch::manual_seed(1);
  for (const Shape& shape : shapes()) {
    const auto x = torch::randn({shape.rows, shape.inputs}), bias = torch::randn({shape.outputs});
    const auto weight = torch::randn({shape.outputs, shape.inputs});
    set_thread_count(1);
    const auto expected = times_transposed(x, weight, bias);
    for (const int threads : {2, 3}) {
      set_thread_count(threads);
      EXPECT_TRUE(torch::equal(times_transposed(x, weight, bias), expected))
          << shape.rows << " x " << shape.inputs << " x " << shape.outputs << ", " << threads << " threads";
    }
  }
  set_thread_count(before);
}

TEST(TransposedProduct, AgreesWithDoubleHoweverItsTensorsLie) {
  const torch::NoGradGuard no_grad;
  torch::manual_seed(2);
  for (const Shape& shape : shapes()) {
    const auto x = torch::randn({shape.rows, shape.inputs}), bias = torch::randn({shape.outputs});
    const auto weight = torch::randn({shape.outputs, shape.inputs});
    const auto expected = torch::mm(x.to(torch::kFloat64), weight.to(torch::kFloat64).t()) + bias;
    // Sums of normal products are about sqrt(inputs) large and at most a few roundings of 2^-24 wrong.
    const double bound = 2e-6 * std::sqrt(static_cast<double>(shape.inputs));
    const auto error = [&](const torch::Tensor& product) {
      return (product.to(torch::kFloat64) - expected).abs().max().item<double>();
    };
    EXPECT_LT(error(times_transposed(x, weight, bias)), bound);
    const auto columns = [](const torch::Tensor& matrix) { return matrix.t().contiguous().t(); };
    EXPECT_LT(error(times_transposed(columns(x), columns(weight), bias)), bound);
    const auto wider = [](const torch::Tensor& matrix) {
      return torch::cat({matrix, torch::randn({matrix.size(0), 3})}, 1).narrow(1, 0, matrix.size(1));
    };
    EXPECT_LT(error(times_transposed(wider(x), wider(weight), torch::stack({bias, bias}, 1).select(1, 0))),
              bound);
  }
  // One row for all, as of a tensor that was expanded.
  const auto row = torch::randn({1, 40}), weight = torch::randn({50, 40});
  EXPECT_TRUE(torch::equal(times_transposed(row.expand({5, 40}), weight),
                           times_transposed(row, weight).expand({5, 50})));
}

TEST(TransposedProduct, OfNothingIsNothing) {
  const torch::NoGradGuard no_grad;
  EXPECT_EQ(times_transposed(torch::zeros({0, 4}), torch::zeros({3, 4})).sizes(),
            (std::vector<int64_t>{0, 3}));
}

class RoundedProduct : public testing::TestWithParam<torch::DeviceType> {};

// Of factors that bfloat16 holds the product is rounded to bfloat16 once at most, and the bias is added in float32.
TEST_P(RoundedProduct, IsRoundedOnceAtMost) {
  const torch::NoGradGuard no_grad;
  torch::manual_seed(3);
  for (const Shape& shape : shapes()) {
    const auto x = torch::randn({shape.rows, shape.inputs}).to(torch::kBFloat16).to(torch::kFloat32);
    const auto weight = torch::randn({shape.outputs, shape.inputs}).to(torch::kBFloat16);
    const auto bias = torch::randn({shape.outputs});
    const auto product = torch::mm(x.to(torch::kFloat64), weight.to(torch::kFloat64).t());
    const auto found = times_rounded(x.to(GetParam()), weight.to(GetParam()), bias.to(GetParam()));
    EXPECT_EQ(found.scalar_type(), torch::kFloat32);
    const auto error = (found.to(torch::kCPU, torch::kFloat64) - product - bias).abs();
    const auto bound = product.abs() * 0x1p-8 + 4e-6 * std::sqrt(static_cast<double>(shape.inputs));
    EXPECT_TRUE((error <= bound).all().item<bool>())
        << shape.rows << " x " << shape.inputs << " x " << shape.outputs;
  }
}

INSTANTIATE_TEST_SUITE_P(Cpu, RoundedProduct, testing::Values(torch::kCPU));
INSTANTIATE_TEST_SUITE_P(on_gpu, RoundedProduct, testing::Values(torch::kCUDA));

}  // namespace
}  // namespace gld
