#include "gld/tensors/transposed_product.h"

#include "gld/kernels/matrix_product.h"
#include "gld/tensors/torch_version.h"

#include <torch/types.h>

namespace gld {
namespace {

bool suits(const torch::Tensor& x) { return x.is_cpu() && x.scalar_type() == torch::kFloat32; }

bool own_product_applies(const torch::Tensor& x, const torch::Tensor& weight, const torch::Tensor& bias) {
  const bool gradients = torch::GradMode::is_enabled() && (x.requires_grad() || weight.requires_grad());
  return !gradients && suits(x) && suits(weight) &&
         (!bias.defined() || (suits(bias) && bias.is_contiguous())) && x.size(0) >= kFewestProductRows &&
         weight.size(1) >= kFewestProductInputs && weight.stride(1) == 1 &&
         weight.stride(0) >= weight.size(1) && x.stride(1) == 1 && x.stride(0) >= x.size(1);
}

torch::Tensor own_product(const torch::Tensor& x, const torch::Tensor& weight, const torch::Tensor& bias) {
  auto y = torch::empty({x.size(0), weight.size(0)}, x.options());
  LinearProduct product;
  product.rows = x.size(0);
  product.inputs = x.size(1);
  product.outputs = weight.size(0);
  product.x = x.data_ptr<float>();
  product.x_stride = x.stride(0);
  product.weight = weight.data_ptr<float>();
  product.weight_stride = weight.stride(0);
  product.bias = bias.defined() ? bias.data_ptr<float>() : nullptr;
  product.y = y.data_ptr<float>();
  product.y_stride = y.stride(0);
  KernelSettings settings;
  settings.threads = thread_count();
  linear_product(product, settings);
  return y;
}

}  // namespace

torch::Tensor times_transposed(const torch::Tensor& x, const torch::Tensor& weight,
                               const torch::Tensor& bias) {
  auto shape = x.sizes().vec();
  shape.back() = weight.size(0);
  // at::linear on LibTorch 1.13 sends (n > 2)-dimensional input through a slower route than one flat addmm.
  const auto flat = x.reshape({-1, x.size(-1)});
  if (own_product_applies(flat, weight, bias)) return own_product(flat, weight, bias).view(shape);
  const auto y = bias.defined() ? torch::addmm(bias, flat, weight.t()) : torch::mm(flat, weight.t());
  return y.view(shape);
}

torch::Tensor times_rounded(const torch::Tensor& x, const torch::Tensor& weight, const torch::Tensor& bias) {
  const auto y = times_transposed(x.to(torch::kBFloat16), weight).to(x.scalar_type());
  return bias.defined() ? y + bias : y;
}

bool rounded_product_applies(const torch::Tensor& weight, ComputePrecision precision) {
  return precision == ComputePrecision::kBFloat16 && !weight.is_cpu() &&
         weight.scalar_type() == torch::kFloat32;
}

}  // namespace gld
