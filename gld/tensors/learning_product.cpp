#include "gld/tensors/learning_product.h"

#include "gld/base/error.h"
#include "gld/tensors/packed_layer.h"

#include <vector>

#include <torch/autograd.h>
#include <torch/types.h>

namespace gld {
namespace {

// Returns a b^T, (rows, depth) with (columns, depth); bias is (columns) or undefined.
torch::Tensor product(const torch::Tensor& a, const torch::Tensor& b, const torch::Tensor& bias,
                      ComputePrecision precision) {
  return PackedLayer(b, 1, precision).times(a, bias, 0, 1);
}

class LearningProduct : public torch::autograd::Function<LearningProduct> {
 public:
  // bias is empty for none; LibTorch's functions take no undefined tensors.
  static torch::Tensor forward(torch::autograd::AutogradContext* context, const torch::Tensor& x,
                               const torch::Tensor& weight, const torch::Tensor& bias, int64_t precision) {
    context->save_for_backward({x, weight});
    context->saved_data["precision"] = precision;
    return product(x, weight, bias.numel() == 0 ? torch::Tensor() : bias,
                   static_cast<ComputePrecision>(precision));
  }

  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 const torch::autograd::variable_list& gradients) {
    if (torch::GradMode::is_enabled()) {
      fail({"learning product", "first derivatives only", "a backward pass that records a graph of its own",
            "compute in float32"});
    }
    const auto saved = context->get_saved_variables();
    const auto precision = static_cast<ComputePrecision>(context->saved_data["precision"].toInt());
    const torch::Tensor gradient = gradients[0].contiguous();
    torch::Tensor of_x, of_weight, of_bias;
    if (context->needs_input_grad(0)) of_x = product(gradient, saved[1].t().contiguous(), {}, precision);
    if (context->needs_input_grad(1)) {
      of_weight = product(gradient.t().contiguous(), saved[0].t().contiguous(), {}, precision);
    }
    if (context->needs_input_grad(2)) of_bias = gradient.sum(0);
    return {of_x, of_weight, of_bias, torch::Tensor()};
  }
};

}  // namespace

bool learning_product_applies(const torch::Tensor& x, const torch::Tensor& weight) {
  const auto suits = [](const torch::Tensor& t) { return t.is_cpu() && t.scalar_type() == torch::kFloat32; };
  return suits(x) && suits(weight) && x.numel() > 0 && weight.numel() > 0;
}

torch::Tensor learning_product(const torch::Tensor& x, const torch::Tensor& weight, const torch::Tensor& bias,
                               ComputePrecision precision) {
  if (precision != ComputePrecision::kBFloat16) {
    fail({"learning product", "bfloat16", compute_precision_name(precision), "train in float32 or bfloat16"});
  }
  auto shape = x.sizes().vec();
  shape.back() = weight.size(0);
  const auto flat = x.reshape({-1, x.size(-1)});
  const auto bias_or_empty = bias.defined() ? bias : torch::empty({0}, flat.options());
  return LearningProduct::apply(flat, weight, bias_or_empty, static_cast<int64_t>(precision)).view(shape);
}

}  // namespace gld
