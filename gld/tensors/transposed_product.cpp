#include "gld/tensors/transposed_product.h"

#include "gld/kernels/matrix_product.h"
#include "gld/tensors/torch_version.h"

#include <torch/types.h>

namespace gld {
namespace {

bool suits(const torch::Tensor& x) { return x.is_cpu() && x.scalar_type() == torch::kFloat32; }

bool own_product_applies(const torch::Tensor& x, const torch::Tensor& weight, const torch::Tensor& bias) {
  const bool gradients = torch::GradMode::is_enabled() && (x.requires_grad() || weight.requires_grad() ||
                                                           (bias.defined() && bias.requires_grad()));
  return !gradients && suits(x) && suits(weight) && (!bias.defined() || suits(bias)) && weight.dim() == 2 &&
         x.numel() > 0 && weight.numel() > 0 && x.size(1) == weight.size(1);
}

// Returns the matrix with its rows in one piece each, any distance apart.
torch::Tensor with_whole_rows(const torch::Tensor& matrix) {
  const bool whole = (matrix.stride(1) == 1 || matrix.size(1) == 1) &&
                     (matrix.stride(0) >= matrix.size(1) || matrix.size(0) == 1);
  return whole ? matrix : matrix.clone(torch::MemoryFormat::Contiguous);
}

// Of a single row any stride may be noted.
int64_t row_stride(const torch::Tensor& matrix) {
  return matrix.size(0) == 1 ? matrix.size(1) : matrix.stride(0);
}

torch::Tensor own_product(const torch::Tensor& given_x, const torch::Tensor& given_weight,
                          const torch::Tensor& given_bias) {
  const auto x = with_whole_rows(given_x), weight = with_whole_rows(given_weight);
  const auto bias = given_bias.defined() ? given_bias.contiguous() : given_bias;
  auto y = torch::empty({x.size(0), weight.size(0)}, x.options());
  LinearProduct product;
  product.rows = x.size(0);
  product.inputs = x.size(1);
  product.outputs = weight.size(0);
  product.x = x.data_ptr<float>();
  product.x_stride = row_stride(x);
  product.weight = weight.data_ptr<float>();
  product.weight_stride = row_stride(weight);
  product.bias = bias.defined() ? bias.data_ptr<float>() : nullptr;
  product.y = y.data_ptr<float>();
  product.y_stride = weight.size(0);
  KernelSettings settings;
  settings.threads = thread_count();
  product.rows < kFewestPackedRows ? few_rows_product(product, settings) : linear_product(product, settings);
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
  auto shape = x.sizes().vec();
  shape.back() = weight.size(0);
  const auto y = bfloat16_product(x.reshape({-1, x.size(-1)}).to(torch::kBFloat16), weight.t()).view(shape);
  return bias.defined() ? y + bias : y;
}

bool rounded_product_applies(const torch::Tensor& weight, ComputePrecision precision) {
  return precision == ComputePrecision::kBFloat16 && !weight.is_cpu() &&
         weight.scalar_type() == torch::kFloat32;
}

}  // namespace gld
