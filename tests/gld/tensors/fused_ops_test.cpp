#include "gld/tensors/fused_ops.h"

#include "gld/kernels/kernel_table.h"

#include <algorithm>
#include <string>
#include <vector>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

torch::Tensor random(torch::IntArrayRef shape) { return torch::randn(shape); }

double relative_error(const torch::Tensor& found, const torch::Tensor& expected) {
  EXPECT_EQ(found.sizes(), expected.sizes());
  EXPECT_TRUE(torch::isfinite(found).all().item<bool>());
  return ((found.to(torch::kFloat64) - expected).abs().max() / expected.abs().max()).item<double>();
}

torch::Tensor exact_rms_norm(const RmsNormInputs& inputs) {
  const auto x = inputs.x.to(torch::kFloat64);
  auto y = x / (x.square().mean(-1, true) + inputs.epsilon).sqrt();
  if (inputs.weight.defined()) y = y * inputs.weight.to(torch::kFloat64);
  if (!inputs.scale.defined()) return y;
  return y * (1 + inputs.scale.to(torch::kFloat64)) + inputs.shift.to(torch::kFloat64);
}

class RmsNormOnDevice : public testing::TestWithParam<torch::DeviceType> {};

TEST_P(RmsNormOnDevice, ModulatesByViewByTokenAndForAll) {
  const torch::NoGradGuard no_grad;
  // A GPU sums a row in another order, and rounds in another place.
  const double bound = GetParam() == torch::kCPU ? 3e-7 : 1e-6;
  for (const int64_t channels : {5, 48, 770}) {
    for (const auto& [views, tokens] :
         std::vector<std::pair<int64_t, int64_t>>{{1, 1}, {3, 1}, {1, 7}, {3, 7}}) {
      RmsNormInputs inputs;
      inputs.x = random({3, 7, channels}).to(GetParam());
      inputs.weight = random({channels}).to(GetParam());
      inputs.epsilon = 1e-6;
      const auto parts = random({views, tokens, 3 * channels}).to(GetParam()).chunk(3, -1);
      inputs.shift = parts[2];
      inputs.scale = parts[0];
      EXPECT_LE(relative_error(rms_norm(inputs), exact_rms_norm(inputs)), bound);
      inputs.shift = inputs.scale = torch::Tensor();
      EXPECT_LE(relative_error(rms_norm(inputs), exact_rms_norm(inputs)), bound);
    }
  }
}

// Weight, shift and scale learn too.
TEST_P(RmsNormOnDevice, EveryPartHasItsGradient) {
  const auto inputs_in = [&](torch::Dtype dtype) {
    torch::manual_seed(5);
    RmsNormInputs inputs;
    const auto make = [&](torch::IntArrayRef shape) {
      return torch::randn(shape).to(GetParam(), dtype).requires_grad_(true);
    };
    inputs.x = make({2, 5, 24});
    inputs.weight = make({24});
    inputs.shift = make({2, 1, 24});
    inputs.scale = make({2, 1, 24});
    inputs.epsilon = 1e-6;
    return inputs;
  };
  const RmsNormInputs single = inputs_in(torch::kFloat32), exact = inputs_in(torch::kFloat64);
  rms_norm(single).pow(3).sum().backward();
  exact_rms_norm(exact).pow(3).sum().backward();
  EXPECT_LE(relative_error(single.x.grad(), exact.x.grad()), 5e-6);
  EXPECT_LE(relative_error(single.weight.grad(), exact.weight.grad()), 5e-6);
  EXPECT_LE(relative_error(single.shift.grad(), exact.shift.grad()), 5e-6);
  EXPECT_LE(relative_error(single.scale.grad(), exact.scale.grad()), 5e-6);
}

TEST_P(RmsNormOnDevice, IsExactToRoundingAtEveryMagnitude) {
  for (const bool gradients : {false, true}) {
    torch::AutoGradMode mode(gradients);
    for (const double magnitude : {1e-38, 1e-30, 1e-22, 1e-10, 1e-3, 1.0, 1e10, 1e19, 1e30, 3e37}) {
      for (const double epsilon : {0.0, 1e-6}) {
        SCOPED_TRACE(testing::Message()
                     << magnitude << " with epsilon " << epsilon << ", gradients " << gradients);
        RmsNormInputs inputs;
        inputs.x = (random({4, 768}) * magnitude).to(GetParam()).requires_grad_(gradients);
        inputs.weight = random({768}).to(GetParam());
        inputs.epsilon = epsilon;
        EXPECT_LE(relative_error(rms_norm(inputs).detach(), exact_rms_norm(inputs).detach()), 5e-7);
      }
    }
    RmsNormInputs zero;
    zero.x = torch::zeros({2, 16}).to(GetParam()).requires_grad_(gradients);
    zero.epsilon = 1e-6;
    EXPECT_EQ(rms_norm(zero).abs().max().item<float>(), 0.0f);
  }
}

TEST_P(RmsNormOnDevice, GradientsAgreeWithDouble) {
  const auto x = random({6, 33}).to(GetParam());
  RmsNormInputs single, exact;
  single.x = x.clone().requires_grad_(true);
  exact.x = x.to(torch::kFloat64).requires_grad_(true);
  single.epsilon = exact.epsilon = 1e-6;
  rms_norm(single).pow(3).sum().backward();
  exact_rms_norm(exact).pow(3).sum().backward();
  EXPECT_LE(relative_error(single.x.grad(), exact.x.grad()), 2e-6);
}

INSTANTIATE_TEST_SUITE_P(Cpu, RmsNormOnDevice, testing::Values(torch::kCPU));
INSTANTIATE_TEST_SUITE_P(on_gpu, RmsNormOnDevice, testing::Values(torch::kCUDA));

TEST(SiluGate, AgreesWithDoubleAlsoFarOut) {
  const torch::NoGradGuard no_grad;
  for (const int64_t width : {1, 7, 64, 5461}) {
    const auto x = 30 * random({3, 5, 2 * width});
    const auto halves = x.to(torch::kFloat64).chunk(2, -1);
    EXPECT_LE(relative_error(silu_gate(x), torch::silu(halves[0]) * halves[1]), 3e-7);
  }
  const auto far = torch::tensor({-1e4f, 1e4f, -1e30f, 1e30f, 1.0f, 1.0f, 1.0f, 1.0f});
  const auto result = silu_gate(far);
  EXPECT_LE(result[0].abs().item<float>(), 1e-30f);
  EXPECT_EQ(result[1].item<float>(), 1e4f);
  EXPECT_EQ(result[3].item<float>(), 1e30f);
}

TEST(GatedSum, BroadcastsTheGate) {
  const torch::NoGradGuard no_grad;
  const auto x = random({3, 7, 50}), update = random({3, 7, 50});
  for (const auto& [views, tokens] :
       std::vector<std::pair<int64_t, int64_t>>{{1, 1}, {3, 1}, {1, 7}, {3, 7}}) {
    const auto gate = random({views, tokens, 100}).chunk(2, -1)[1];
    const auto exact = x.to(torch::kFloat64) + gate.to(torch::kFloat64) * update.to(torch::kFloat64);
    EXPECT_LE(relative_error(gated_sum(x, gate, update), exact), 2e-7);
  }
}

// The kernels of all instruction sets, not only the widest.
class ElementKernels : public testing::TestWithParam<InstructionSet> {};

INSTANTIATE_TEST_SUITE_P(Portable, ElementKernels, testing::Values(InstructionSet::kPortable));
INSTANTIATE_TEST_SUITE_P(on_avx2, ElementKernels, testing::Values(InstructionSet::kAvx2));
INSTANTIATE_TEST_SUITE_P(on_avx512, ElementKernels, testing::Values(InstructionSet::kAvx512));

TEST_P(ElementKernels, AgreeWithDouble) {
  const KernelTable& kernels = kernel_table(GetParam());
  const auto x = random({4, 45}), scale = random({2, 45}), shift = random({2, 45});
  auto y = torch::empty({4, 45});
  RmsNormRows norm = {};
  norm.x = x.data_ptr<float>();
  norm.rows = 4;
  norm.channels = norm.x_stride = norm.modulation_stride = 45;
  norm.rows_per_modulation = 2;
  norm.epsilon = 1e-6;
  norm.scale = scale.data_ptr<float>();
  norm.shift = shift.data_ptr<float>();
  norm.y = y.data_ptr<float>();
  kernels.rms_norm(norm);
  RmsNormInputs inputs;
  inputs.x = x.view({2, 2, 45});
  inputs.scale = scale.unsqueeze(1);
  inputs.shift = shift.unsqueeze(1);
  inputs.epsilon = 1e-6;
  EXPECT_LE(relative_error(y.view({2, 2, 45}), exact_rms_norm(inputs)), 3e-7);

  SwigluRows gate = {};
  const auto joint = 20 * random({4, 90});
  gate.a = joint.data_ptr<float>();
  gate.b = gate.a + 45;
  gate.rows = 4;
  gate.channels = gate.y_stride = 45;
  gate.stride = 90;
  gate.y = y.data_ptr<float>();
  kernels.swiglu(gate);
  const auto halves = joint.to(torch::kFloat64).chunk(2, -1);
  EXPECT_LE(relative_error(y, torch::silu(halves[0]) * halves[1]), 4e-7);

  GatedSumRows sum = {};
  const auto update = random({4, 45});
  sum.x = x.data_ptr<float>();
  sum.update = update.data_ptr<float>();
  sum.gate = scale.data_ptr<float>();
  sum.rows = 4;
  sum.channels = sum.gate_stride = 45;
  sum.rows_per_gate = 2;
  sum.y = y.data_ptr<float>();
  kernels.gated_sum(sum);
  const auto gates = scale.to(torch::kFloat64).repeat_interleave(2, 0);
  EXPECT_LE(relative_error(y, x.to(torch::kFloat64) + gates * update.to(torch::kFloat64)), 2e-7);
  EXPECT_GT(kernels.multiply_add_loop(10), 0);
}

}  // namespace
}  // namespace gld
