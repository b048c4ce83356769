#include "gld/attention/fused_attention.h"

#include "gld/attention/attention.h"
#include "gld/attention/composed_attention.h"
#include "gld/tensors/torch_version.h"
#include "tests/support/error_of.h"

#include <cmath>

#include <torch/autograd.h>
#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

double relative_error(const torch::Tensor& found, const torch::Tensor& expected) {
  const auto a = found.to(torch::kFloat64);
  const auto b = expected.to(torch::kFloat64);
  EXPECT_EQ(a.sizes(), b.sizes());
  return (a - b).abs().max().item<double>() / b.abs().max().item<double>();
}

struct Scene {
  int64_t views = 3;
  int64_t prefix = 2;
  int64_t height = 4;
  int64_t width = 5;
  int64_t heads = 3;
  int64_t head_dim = 24;

  int64_t tokens() const { return views * (prefix + height * width); }
};

// Makes the tables as gld/camera_encoding/prope.cpp makes them, but with arbitrary matrices.
PropeTables tables_for(const Scene& scene, const torch::TensorOptions& options) {
  PropeTables tables;
  tables.grid = {scene.views, scene.height, scene.width};
  tables.prefix_tokens = scene.prefix;
  const auto eye = torch::eye(4, torch::kFloat64);
  const auto matrices = [&] {
    return (eye + 0.3 * torch::randn({scene.views, 4, 4})).to(torch::kFloat32).to(options);
  };
  tables.query_matrix = matrices();
  tables.key_value_matrix = matrices();
  tables.output_matrix = matrices();
  const auto column = torch::randn({scene.width, scene.head_dim / 8});
  const auto row = torch::randn({scene.height, scene.head_dim / 8});
  tables.column_cos = column.cos().to(options);
  tables.column_sin = column.sin().to(options);
  tables.row_cos = row.cos().to(options);
  tables.row_sin = row.sin().to(options);
  return tables;
}

PropeTables in_double(PropeTables tables) {
  for (auto* table : {&tables.query_matrix, &tables.key_value_matrix, &tables.output_matrix,
                      &tables.column_cos, &tables.column_sin, &tables.row_cos, &tables.row_sin}) {
    *table = table->to(torch::kFloat64);
  }
  return tables;
}

// Queries, keys and values are slices of one joint array (1, tokens, 3, heads, head_dim).
AttentionInputs inputs_from(const torch::Tensor& joint, const PropeTables* prope) {
  AttentionInputs inputs;
  inputs.query = joint.select(2, 0);
  inputs.key = joint.select(2, 1);
  inputs.value = joint.select(2, 2);
  inputs.prope = prope;
  return inputs;
}

class FusedAttentionTest : public testing::Test {
 protected:
  void SetUp() override { torch::manual_seed(4); }

  // Compares output and gradient of the joint array, in float32 through attention() and in double through the
  // composition.
  void compare(const Scene& scene, const PropeTables* prope) {
    const auto joint = torch::randn({1, scene.tokens(), 3, scene.heads, scene.head_dim});
    const auto weights = torch::randn({1, scene.tokens(), scene.heads, scene.head_dim});
    const auto single = joint.clone().requires_grad_(true);
    const auto output = attention(inputs_from(single, prope));
    EXPECT_TRUE(output.is_contiguous());
    (output * weights).sum().backward();

    const auto exact = joint.to(torch::kFloat64).requires_grad_(true);
    PropeTables exact_tables;
    if (prope != nullptr) exact_tables = in_double(*prope);
    const auto expected = composed_attention(inputs_from(exact, prope == nullptr ? nullptr : &exact_tables));
    (expected * weights.to(torch::kFloat64)).sum().backward();
    EXPECT_LE(relative_error(output, expected), 2e-6);
    EXPECT_LE(relative_error(single.grad(), exact.grad()), 5e-6);

    const torch::NoGradGuard no_grad;
    EXPECT_TRUE(torch::equal(attention(inputs_from(joint, prope)), output));
    EXPECT_LE(relative_error(row_blocked_attention(inputs_from(joint, prope)), expected), 4e-6);
  }
};

TEST_F(FusedAttentionTest, AgreesWithTheCompositionInDouble) { compare({}, nullptr); }

TEST_F(FusedAttentionTest, AgreesWithCameraEncoding) {
  const auto tables = tables_for({}, torch::kFloat32);
  compare({}, &tables);
}

TEST_F(FusedAttentionTest, TakesAnyStrides) {
  const auto channels_first = torch::randn({2, 3, 16, 40});  // (batch, heads, head_dim, tokens)
  AttentionInputs inputs;
  inputs.query = channels_first.permute({0, 3, 1, 2});
  inputs.key = inputs.query.flip(1);
  inputs.value = torch::randn({1, 40, 1, 16}).expand({2, 40, 3, 16});
  AttentionInputs exact;
  exact.query = inputs.query.to(torch::kFloat64);
  exact.key = inputs.key.to(torch::kFloat64);
  exact.value = inputs.value.to(torch::kFloat64);
  EXPECT_LE(relative_error(attention(inputs), composed_attention(exact)), 2e-6);
}

TEST_F(FusedAttentionTest, OnlyKeysOnlyValuesOrOnlyQueriesMayNeedGradients) {
  const auto x = torch::randn({1, 30, 2, 16});
  for (int part = 0; part < 3; ++part) {
    AttentionInputs single, exact;
    torch::Tensor* parts[] = {&single.query, &single.key, &single.value};
    torch::Tensor* exact_parts[] = {&exact.query, &exact.key, &exact.value};
    for (int i = 0; i < 3; ++i) {
      *parts[i] = x.roll(i, 1).clone().requires_grad_(i == part);
      *exact_parts[i] = x.roll(i, 1).to(torch::kFloat64).requires_grad_(i == part);
    }
    attention(single).square().sum().backward();
    composed_attention(exact).square().sum().backward();
    EXPECT_LE(relative_error(parts[part]->grad(), exact_parts[part]->grad()), 5e-6);
  }
}

TEST_F(FusedAttentionTest, GradientsAreOfThePrecisionOfTheOutput) {
  AttentionInputs inputs;
  inputs.query = torch::randn({1, 40, 2, 16}).requires_grad_(true);
  inputs.key = torch::randn({1, 50, 2, 16}).requires_grad_(true);
  inputs.value = torch::randn({1, 50, 2, 16}).requires_grad_(true);
  const auto gradient = torch::randn({1, 40, 2, 16});
  const auto through_the_graph = [&] {
    return torch::autograd::grad({attention(inputs)}, {inputs.query, inputs.key, inputs.value}, {gradient});
  };
  const auto exact = through_the_graph();
  inputs.precision = ComputePrecision::kBFloat16;
  const auto reduced = through_the_graph();
  const auto expected = fused_attention_gradients(inputs, fused_attention_result(inputs), gradient);
  EXPECT_TRUE(torch::equal(reduced[0], expected.query));
  EXPECT_TRUE(torch::equal(reduced[1], expected.key));
  EXPECT_TRUE(torch::equal(reduced[2], expected.value));
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_GT(relative_error(reduced[i], exact[i]), 1e-3);
    EXPECT_LT(relative_error(reduced[i], exact[i]), 3e-2);
  }
}

TEST_F(FusedAttentionTest, OtherTypesTakeTheLibrarysOperations) {
  AttentionInputs inputs;
  inputs.query = inputs.key = inputs.value = torch::randn({1, 20, 2, 16}, torch::kFloat64);
  EXPECT_FALSE(fused_attention_applies(inputs));
  EXPECT_LE(relative_error(attention(inputs), composed_attention(inputs)), 1e-15);
  inputs.query = inputs.key = inputs.value = inputs.query.to(torch::kBFloat16);
  EXPECT_FALSE(fused_attention_applies(inputs));
  EXPECT_EQ(attention(inputs).scalar_type(), torch::kBFloat16);
}

TEST_F(FusedAttentionTest, RefusesSecondDerivatives) {
  const auto x = torch::randn({1, 5, 1, 16}).requires_grad_(true);
  AttentionInputs inputs;
  inputs.query = inputs.key = inputs.value = x;
  const auto sum = attention(inputs).sum();
  EXPECT_EQ(test::error_of(
                [&] { torch::autograd::grad({sum}, {x}, {}, /*retain_graph=*/true, /*create_graph=*/true); }),
            "attention: expected first derivatives only, "
            "found a backward pass that records a graph of its own; "
            "compute in double precision, which uses differentiable operations.");
}

TEST_F(FusedAttentionTest, EmptyInputsGiveEmptyOrZeroOutputs) {
  AttentionInputs inputs;
  inputs.query = torch::randn({1, 3, 2, 16});
  inputs.key = inputs.value = torch::empty({1, 0, 2, 16});
  EXPECT_TRUE(torch::equal(attention(inputs), torch::zeros({1, 3, 2, 16})));
  inputs.query = torch::empty({1, 0, 2, 16});
  EXPECT_EQ(attention(inputs).numel(), 0);
}

// The kernel of LibTorch 2 beside ours, and the sentence that LibTorch 1 gets: an entry of its own for each, so that
// the one that cannot run is counted.
struct LibTorchsOwnKernel : testing::TestWithParam<ComputePrecision> {
  LibTorchsOwnKernel() { torch::manual_seed(7); }
};

TEST_P(LibTorchsOwnKernel, IsTheSame) {
  const auto joint = torch::randn({1, 40, 3, 2, 24});
  const auto exact = composed_attention(inputs_from(joint.to(torch::kFloat64), nullptr));
  AttentionInputs inputs = inputs_from(joint, nullptr);
  inputs.precision = GetParam();
  const auto found = library_attention(inputs);
  EXPECT_EQ(found.scalar_type(), torch::kFloat32);
  const double error = relative_error(found, exact);
  if (GetParam() == ComputePrecision::kFloat32) {
    EXPECT_LE(error, 2e-6);
  } else {
    EXPECT_LE(error, 2e-2);
    EXPECT_GT(error, 1e-4);
  }
}

INSTANTIATE_TEST_SUITE_P(on_libtorch_2, LibTorchsOwnKernel,
                         testing::Values(ComputePrecision::kFloat32, ComputePrecision::kBFloat16));

struct LibTorchWithoutKernel : testing::TestWithParam<ComputePrecision> {};

TEST_P(LibTorchWithoutKernel, SaysSo) {
  AttentionInputs inputs = inputs_from(torch::randn({1, 40, 3, 2, 24}), nullptr);
  inputs.precision = GetParam();
  EXPECT_EQ(test::error_of([&] { library_attention(inputs); }),
            "scaled_dot_product_attention: expected LibTorch 2.0 or newer, found " + torch_version() +
                "; call attention() instead.");
}

INSTANTIATE_TEST_SUITE_P(on_libtorch_1, LibTorchWithoutKernel,
                         testing::Values(ComputePrecision::kFloat32, ComputePrecision::kBFloat16));

}  // namespace
}  // namespace gld
