#include "gld/tensors/fused_ops.h"

#include "gld/kernels/kernel_table.h"
#include "gld/tensors/torch_version.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <optional>

#include <ATen/Parallel.h>
#include <torch/types.h>

namespace gld {
namespace {

// A thread takes so many floats at a time.
constexpr int64_t kFloatsAPart = 32768;

bool one_pass_applies(std::initializer_list<torch::Tensor> tensors) {
  return std::all_of(tensors.begin(), tensors.end(), [](const torch::Tensor& x) {
    return !x.defined() || (x.is_cpu() && x.scalar_type() == torch::kFloat32 &&
                            !(torch::GradMode::is_enabled() && x.requires_grad()));
  });
}

// How one row of a broadcast tensor belongs to several consecutive rows of x.
struct BroadcastRows {
  int64_t rows_each;
  int64_t stride;
};

// Returns nothing where the tensor's strides do not allow that.
std::optional<BroadcastRows> broadcast_rows(const torch::Tensor& vectors, const torch::Tensor& x) {
  const auto full = vectors.expand_as(x);
  if (full.size(-1) > 1 && full.stride(-1) != 1) return std::nullopt;
  BroadcastRows result = {1, 0};
  int64_t dimension = x.dim() - 2;
  for (; dimension >= 0 && (full.stride(dimension) == 0 || full.size(dimension) == 1); --dimension) {
    result.rows_each *= full.size(dimension);
  }
  if (dimension < 0) return result;
  result.stride = full.stride(dimension);
  int64_t expected = result.stride;
  for (; dimension >= 0; --dimension) {
    if (full.size(dimension) != 1 && full.stride(dimension) != expected) return std::nullopt;
    expected *= full.size(dimension);
  }
  return result;
}

void for_rows(int64_t rows, int64_t channels, const std::function<void(int64_t, int64_t)>& part) {
  at::parallel_for(0, rows, std::max<int64_t>(1, kFloatsAPart / std::max<int64_t>(1, channels)), part);
}

const KernelTable& kernels() { return kernel_table(best_instruction_set()); }

torch::Tensor composed_rms_norm(const RmsNormInputs& inputs) {
  // Halves are normalised in float32, as their own range ends at 65504.
  const auto wide = inputs.x.element_size() < 4 ? inputs.x.to(torch::kFloat32) : inputs.x;
  // The scale is a power of two near each row's largest value, but not so small that epsilon divided by its square
  // overflows: x is then far below sqrt(epsilon), and its square may vanish.
  const double smallest =
      std::max<double>(std::numeric_limits<float>::min(), std::sqrt(inputs.epsilon) * 0x1p-40);
  const auto largest = wide.detach().abs().amax(-1, /*keepdim=*/true).clamp_min(smallest);
  const auto scale = torch::exp2(torch::floor(torch::log2(largest)));
  const auto scaled = wide / scale;
  auto mean = scaled.square().mean(-1, /*keepdim=*/true);
  mean = inputs.epsilon > 0 ? mean + (std::sqrt(inputs.epsilon) / scale).square()
                            : mean.clamp_min(std::numeric_limits<float>::min());
  auto y = (scaled * torch::rsqrt(mean)).to(inputs.x.scalar_type());
  if (inputs.weight.defined()) y = y * inputs.weight;
  return inputs.scale.defined() ? y * (1.0 + inputs.scale) + inputs.shift : y;
}

// On a GPU in few passes over x. Only rows whose squares could overflow are divided, by a power of two beside whose
// square epsilon is nothing; what is far below sqrt(epsilon) may lose its square.
torch::Tensor rms_norm_by_library(const RmsNormInputs& inputs) {
  constexpr double kLargestExponent = 60;  // 2^60, squared and summed over any row, is far from 2^128
  const auto wide = inputs.x.to(torch::kFloat32);
  const auto largest = torch::linalg_vector_norm(wide.detach(), std::numeric_limits<double>::infinity(), {-1},
                                                 /*keepdim=*/true);
  const auto divisor = torch::exp2(torch::floor(torch::log2(largest)) - kLargestExponent).clamp_min(1.0);
  const auto y = library_rms_norm(wide / divisor, inputs.weight, inputs.epsilon);
  if (inputs.scale.defined()) return torch::addcmul(inputs.shift, y, 1.0 + inputs.scale);
  return inputs.weight.defined() ? y : y.to(inputs.x.scalar_type());
}

}  // namespace

torch::Tensor rms_norm(const RmsNormInputs& inputs) {
  if (inputs.x.dim() < 1 || inputs.x.numel() == 0 ||
      !one_pass_applies({inputs.x, inputs.weight, inputs.shift, inputs.scale})) {
    constexpr double kLeastEpsilon = 1e-30;  // float32 has its inverse root
    const bool library = has_library_rms_norm(inputs.x.device()) && inputs.x.element_size() <= 4 &&
                         inputs.epsilon >= kLeastEpsilon && inputs.x.numel() > 0;
    return library ? rms_norm_by_library(inputs) : composed_rms_norm(inputs);
  }
  const auto x = inputs.x.contiguous();
  const int64_t channels = x.size(-1), rows = x.numel() / channels;
  RmsNormRows task = {};
  if (inputs.scale.defined()) {
    const auto scale_rows = broadcast_rows(inputs.scale, x);
    const auto shift_rows = broadcast_rows(inputs.shift, x);
    if (!scale_rows || !shift_rows || scale_rows->rows_each != shift_rows->rows_each ||
        scale_rows->stride != shift_rows->stride) {
      return composed_rms_norm(inputs);
    }
    task.rows_per_modulation = scale_rows->rows_each;
    task.modulation_stride = scale_rows->stride;
    task.scale = inputs.scale.data_ptr<float>();
    task.shift = inputs.shift.data_ptr<float>();
  }
  const auto weight = inputs.weight.defined() ? inputs.weight.contiguous() : torch::Tensor();
  auto y = torch::empty_like(x);
  task.channels = task.x_stride = channels;
  task.epsilon = inputs.epsilon;
  task.weight = weight.defined() ? weight.data_ptr<float>() : nullptr;
  const float* from = x.data_ptr<float>();
  float* to = y.data_ptr<float>();
  for_rows(rows, channels, [&](int64_t begin, int64_t end) {
    RmsNormRows part = task;
    part.x = from + begin * channels;
    part.y = to + begin * channels;
    part.first_row = begin;
    part.rows = end - begin;
    kernels().rms_norm(part);
  });
  return y;
}

torch::Tensor silu_gate(const torch::Tensor& x) {
  const int64_t width = x.size(-1) / 2;
  if (!one_pass_applies({x}) || !x.is_contiguous() || x.numel() == 0) {
    const auto halves = x.chunk(2, -1);
    return torch::silu(halves[0]) * halves[1];
  }
  auto shape = x.sizes().vec();
  shape.back() = width;
  auto y = torch::empty(shape, x.options());
  const float* from = x.data_ptr<float>();
  float* to = y.data_ptr<float>();
  for_rows(y.numel() / width, width, [&](int64_t begin, int64_t end) {
    SwigluRows part = {};
    part.a = from + begin * 2 * width;
    part.b = part.a + width;
    part.rows = end - begin;
    part.channels = width;
    part.stride = 2 * width;
    part.y = to + begin * width;
    part.y_stride = width;
    kernels().swiglu(part);
  });
  return y;
}

torch::Tensor gated_sum(const torch::Tensor& x, const torch::Tensor& gate, const torch::Tensor& update) {
  const auto composed = [&] { return x + gate * update; };
  if (!one_pass_applies({x, gate, update}) || x.sizes() != update.sizes() || x.numel() == 0 || x.dim() < 1) {
    return composed();
  }
  const auto gate_rows = broadcast_rows(gate, x);
  if (!gate_rows) return composed();
  const auto first = x.contiguous();
  const auto second = update.contiguous();
  auto y = torch::empty_like(first);
  const int64_t channels = x.size(-1);
  const float* x_data = first.data_ptr<float>();
  const float* update_data = second.data_ptr<float>();
  const float* gate_data = gate.data_ptr<float>();
  float* y_data = y.data_ptr<float>();
  for_rows(x.numel() / channels, channels, [&](int64_t begin, int64_t end) {
    GatedSumRows part = {};
    part.x = x_data + begin * channels;
    part.update = update_data + begin * channels;
    part.gate = gate_data;
    part.rows = end - begin;
    part.channels = channels;
    part.rows_per_gate = gate_rows->rows_each;
    part.gate_stride = gate_rows->stride;
    part.first_row = begin;
    part.y = y_data + begin * channels;
    kernels().gated_sum(part);
  });
  return y;
}

}  // namespace gld
