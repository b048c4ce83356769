#include "models/activation_checkpoint.h"

#include "gld/torch_version.h"

#include <optional>
#include <utility>

#include <torch/autograd.h>
#include <torch/custom_class.h>

namespace gld {
namespace {

struct HeldBlock : torch::CustomClassHolder {
  BlockFunction block;
  bool autocast = false;
  bool conditioned = false;
};

torch::Tensor leaf_of(const torch::Tensor& tensor) {
  return tensor.detach().requires_grad_(tensor.requires_grad());
}

class Recompute : public torch::autograd::Function<Recompute> {
 public:
  static torch::Tensor forward(torch::autograd::AutogradContext* context, const torch::Tensor& x,
                               const torch::Tensor& conditioning, const c10::intrusive_ptr<HeldBlock>& held) {
    context->save_for_backward({x, conditioning});
    context->saved_data["block"] = c10::IValue::make_capsule(held);
    return held->block(x, held->conditioned ? conditioning : torch::Tensor());
  }

  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 const torch::autograd::variable_list& gradients) {
    const auto saved = context->get_saved_variables();
    const auto held = c10::static_intrusive_pointer_cast<HeldBlock>(context->saved_data["block"].toCapsule());
    const auto x = leaf_of(saved[0]);
    const auto conditioning = held->conditioned ? leaf_of(saved[1]) : torch::Tensor();
    torch::Tensor y;
    {
      const torch::AutoGradMode with_gradients(true);
      std::optional<BFloat16Autocast> autocast;
      if (held->autocast) autocast.emplace(x.device().type());
      y = held->block(x, conditioning);
    }
    torch::autograd::backward({y}, {gradients[0]});
    return {x.grad(), conditioning.defined() ? conditioning.grad() : torch::Tensor(), torch::Tensor()};
  }
};

}  // namespace

torch::Tensor checkpointed(const BlockFunction& block, const torch::Tensor& x,
                           const torch::Tensor& conditioning) {
  const bool has_gradient = x.requires_grad() || (conditioning.defined() && conditioning.requires_grad());
  // Autograd only comes back to the block through an input with a gradient.
  if (!torch::GradMode::is_enabled() || !has_gradient) return block(x, conditioning);
  auto held = c10::make_intrusive<HeldBlock>();
  held->block = block;
  held->autocast = bfloat16_autocast_active(x.device().type());
  held->conditioned = conditioning.defined();
  // An undefined tensor cannot be saved.
  return Recompute::apply(x, held->conditioned ? conditioning : torch::empty({0}, x.options()), held);
}

}  // namespace gld
