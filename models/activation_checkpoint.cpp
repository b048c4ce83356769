#include "models/activation_checkpoint.h"

#include "gld/fused_attention.h"
#include "gld/torch_version.h"

#include <functional>
#include <optional>
#include <utility>

#include <torch/autograd.h>
#include <torch/custom_class.h>

namespace gld {
namespace {

// Undefined tensors cannot be saved: an empty one of this kind stands for each.
torch::Tensor saveable(const torch::Tensor& tensor, const torch::Tensor& like) {
  return tensor.defined() ? tensor : torch::empty({0}, like.options());
}

using PartFunction = std::function<torch::Tensor(const torch::Tensor& x, const torch::Tensor& second,
                                                 const torch::Tensor& conditioning)>;

struct HeldPart : torch::CustomClassHolder {
  PartFunction part;
  bool autocast = false;
  bool has_second = false;
  bool conditioned = false;
};

struct HeldAttention : torch::CustomClassHolder {
  std::function<AttentionInputs(const torch::Tensor&, const torch::Tensor&)> inputs;
  bool conditioned = false;
};

torch::Tensor leaf_of(const torch::Tensor& tensor) {
  return tensor.detach().requires_grad_(tensor.requires_grad());
}

torch::Tensor leaf_if(bool wanted, const torch::Tensor& tensor) {
  return wanted ? leaf_of(tensor) : torch::Tensor();
}

torch::Tensor gradient_if(const torch::Tensor& leaf) {
  return leaf.defined() ? leaf.grad() : torch::Tensor();
}

class Recompute : public torch::autograd::Function<Recompute> {
 public:
  static torch::Tensor forward(torch::autograd::AutogradContext* context, const torch::Tensor& x,
                               const torch::Tensor& second, const torch::Tensor& conditioning,
                               const c10::intrusive_ptr<HeldPart>& held) {
    context->save_for_backward({x, second, conditioning});
    context->saved_data["part"] = c10::IValue::make_capsule(held);
    return held->part(x, held->has_second ? second : torch::Tensor(),
                      held->conditioned ? conditioning : torch::Tensor());
  }

  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 const torch::autograd::variable_list& gradients) {
    const auto saved = context->get_saved_variables();
    const auto held = c10::static_intrusive_pointer_cast<HeldPart>(context->saved_data["part"].toCapsule());
    const auto x = leaf_of(saved[0]);
    const auto second = leaf_if(held->has_second, saved[1]);
    const auto conditioning = leaf_if(held->conditioned, saved[2]);
    torch::Tensor y;
    {
      const torch::AutoGradMode with_gradients(true);
      std::optional<BFloat16Autocast> autocast;
      if (held->autocast) autocast.emplace(x.device().type());
      y = held->part(x, second, conditioning);
    }
    torch::autograd::backward({y}, {gradients[0]});
    return {x.grad(), gradient_if(second), gradient_if(conditioning), torch::Tensor()};
  }
};

// Attention whose output is kept and whose inputs are computed again.
class RecomputeInputs : public torch::autograd::Function<RecomputeInputs> {
 public:
  static torch::Tensor forward(torch::autograd::AutogradContext* context, const torch::Tensor& x,
                               const torch::Tensor& conditioning,
                               const c10::intrusive_ptr<HeldAttention>& held) {
    const auto result =
        fused_attention_result(held->inputs(x, held->conditioned ? conditioning : torch::Tensor()));
    context->save_for_backward({x, conditioning, result.output, result.log_sum_exp});
    context->saved_data["attention"] = c10::IValue::make_capsule(held);
    return result.output;
  }

  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 const torch::autograd::variable_list& gradients) {
    const auto saved = context->get_saved_variables();
    const auto held =
        c10::static_intrusive_pointer_cast<HeldAttention>(context->saved_data["attention"].toCapsule());
    const auto x = leaf_of(saved[0]);
    const auto conditioning = leaf_if(held->conditioned, saved[1]);
    AttentionInputs inputs;
    {
      const torch::AutoGradMode with_gradients(true);
      inputs = held->inputs(x, conditioning);
    }
    const auto inner = fused_attention_gradients(inputs, {saved[2], saved[3]}, gradients[0]);
    torch::autograd::backward({inputs.query, inputs.key, inputs.value},
                              {inner.query, inner.key, inner.value});
    return {x.grad(), gradient_if(conditioning), torch::Tensor()};
  }
};

// Autograd only comes back to a part through an input with a gradient.
bool records(const torch::Tensor& x, const torch::Tensor& conditioning) {
  return torch::GradMode::is_enabled() &&
         (x.requires_grad() || (conditioning.defined() && conditioning.requires_grad()));
}

torch::Tensor recompute(const PartFunction& part, const torch::Tensor& x, const torch::Tensor& second,
                        const torch::Tensor& conditioning) {
  auto held = c10::make_intrusive<HeldPart>();
  held->part = part;
  held->autocast = bfloat16_autocast_active(x.device().type());
  held->has_second = second.defined();
  held->conditioned = conditioning.defined();
  return Recompute::apply(x, saveable(second, x), saveable(conditioning, x), held);
}

bool kernels_apply(const torch::Tensor& x) { return x.is_cpu() && x.scalar_type() == torch::kFloat32; }

}  // namespace

torch::Tensor checkpointed(const BlockFunction& block, const torch::Tensor& x,
                           const torch::Tensor& conditioning) {
  if (!records(x, conditioning)) return block(x, conditioning);
  const PartFunction part = [block](const torch::Tensor& tokens, const torch::Tensor& /*second*/,
                                    const torch::Tensor& c) { return block(tokens, c); };
  return recompute(part, x, {}, conditioning);
}

torch::Tensor checkpointed(const AttentionBlock& block, const torch::Tensor& x,
                           const torch::Tensor& conditioning) {
  if (!records(x, conditioning) || !kernels_apply(x)) {
    const BlockFunction whole = [block](const torch::Tensor& tokens, const torch::Tensor& c) {
      return block.finish(tokens, attention(block.inputs(tokens, c)), c);
    };
    return checkpointed(whole, x, conditioning);
  }
  auto held = c10::make_intrusive<HeldAttention>();
  held->inputs = block.inputs;
  held->conditioned = conditioning.defined();
  const auto attended = RecomputeInputs::apply(x, saveable(conditioning, x), held);
  return recompute(block.finish, x, attended, conditioning);
}

}  // namespace gld
