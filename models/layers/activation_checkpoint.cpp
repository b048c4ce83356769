#include "models/layers/activation_checkpoint.h"

#include "gld/attention/fused_attention.h"
#include "gld/tensors/torch_version.h"
#include "models/layers/adaptive_norm.h"

#include <algorithm>
#include <functional>
#include <optional>
#include <utility>

#include <torch/autograd.h>
#include <torch/custom_class.h>

namespace gld {
namespace {

enum class ViewDependence { kTogether, kAlone };

// Undefined tensors cannot be saved: an empty one of this kind stands for each.
torch::Tensor saveable(const torch::Tensor& tensor, const torch::Tensor& like) {
  return tensor.defined() ? tensor : torch::empty({0}, like.options());
}

torch::Tensor undefined_if_empty(const torch::Tensor& tensor) {
  return tensor.numel() == 0 ? torch::Tensor() : tensor;
}

torch::Tensor leaf_of(const torch::Tensor& tensor) {
  return tensor.defined() ? tensor.detach().requires_grad_(tensor.requires_grad()) : tensor;
}

torch::Tensor gradient_of(const torch::Tensor& leaf) {
  return leaf.defined() ? leaf.grad() : torch::Tensor();
}

// Returns a leaf of the rows of a group of views, of a tensor with a row a view or one for all of them.
torch::Tensor leaf_of_group(const torch::Tensor& tensor, const ViewGroup& group, int64_t views) {
  if (!tensor.defined() || tensor.size(0) != views) return leaf_of(tensor);
  // Where no gradients are recorded, a part of a tensor does not ask for them even if the tensor does.
  return tensor.detach().narrow(0, group.first, group.count).requires_grad_(tensor.requires_grad());
}

// Collects the gradient of a whole tensor group by group.
class GradientOfGroups {
 public:
  explicit GradientOfGroups(const torch::Tensor& whole) : whole_(whole) {}

  void add(const ViewGroup& group, int64_t views, const torch::Tensor& gradient) {
    if (!gradient.defined()) return;
    if (group.count == views) {
      sum_ = gradient;
    } else if (whole_.size(0) == views) {
      if (!sum_.defined()) sum_ = torch::zeros(whole_.sizes(), gradient.options());
      sum_.narrow(0, group.first, group.count).copy_(gradient);
    } else {
      sum_ = sum_.defined() ? sum_ + gradient : gradient;
    }
  }
  torch::Tensor take() { return sum_; }

 private:
  torch::Tensor whole_, sum_;
};

using GroupFunction = std::function<torch::Tensor(const std::vector<torch::Tensor>&)>;

// Returns the gradients of function(tensors) with respect to its tensors, where the result's is known; computed for few
// views at a time where they do not depend on each other. tensors have views first; undefined ones are handed on.
std::vector<torch::Tensor> gradients_of(const GroupFunction& function,
                                        const std::vector<torch::Tensor>& tensors, const torch::Tensor& known,
                                        ViewDependence dependence) {
  const torch::Tensor& x = tensors.front();
  const int64_t views = x.size(0);
  const int64_t tokens = x.dim() > 2 ? x.size(1) : 1;
  const int64_t size = dependence == ViewDependence::kTogether
                           ? views
                           : std::clamp<int64_t>(kTokensRecomputedAtOnce / std::max<int64_t>(1, tokens), 1,
                                                 std::max<int64_t>(1, views));
  std::vector<GradientOfGroups> sums(tensors.begin(), tensors.end());
  for (int64_t first = 0; first < views; first += size) {
    const ViewGroup group{first, std::min(size, views - first)};
    std::vector<torch::Tensor> leaves;
    leaves.reserve(tensors.size());
    for (const auto& tensor : tensors) leaves.push_back(leaf_of_group(tensor, group, views));
    torch::Tensor result;
    {
      const torch::AutoGradMode with_gradients(true);
      result = function(leaves);
    }
    torch::autograd::backward({result}, {size == views ? known : known.narrow(0, group.first, group.count)});
    for (size_t i = 0; i < leaves.size(); ++i) sums[i].add(group, views, gradient_of(leaves[i]));
  }
  std::vector<torch::Tensor> gradients;
  gradients.reserve(sums.size());
  for (auto& sum : sums) gradients.push_back(sum.take());
  return gradients;
}

torch::Tensor added(const torch::Tensor& a, const torch::Tensor& b) {
  if (!a.defined()) return b;
  return b.defined() ? a + b : a;
}

struct HeldPart : torch::CustomClassHolder {
  PartFunction part;
  ViewDependence dependence = ViewDependence::kTogether;
  bool autocast = false;
};

class Recompute : public torch::autograd::Function<Recompute> {
 public:
  static torch::Tensor forward(torch::autograd::AutogradContext* context, const torch::Tensor& x,
                               const torch::Tensor& conditioning, const c10::intrusive_ptr<HeldPart>& held) {
    context->save_for_backward({x, conditioning});
    context->saved_data["part"] = c10::IValue::make_capsule(held);
    return held->part(x, undefined_if_empty(conditioning));
  }

  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 const torch::autograd::variable_list& gradients) {
    const auto saved = context->get_saved_variables();
    const auto held = c10::static_intrusive_pointer_cast<HeldPart>(context->saved_data["part"].toCapsule());
    const auto inner = gradients_of(
        [&](const std::vector<torch::Tensor>& t) {
          std::optional<BFloat16Autocast> autocast;
          if (held->autocast) autocast.emplace(t[0].device().type());
          return held->part(t[0], t[1]);
        },
        {saved[0], undefined_if_empty(saved[1])}, gradients[0], held->dependence);
    return {inner[0], inner[1], torch::Tensor()};
  }
};

struct HeldBlocks : torch::CustomClassHolder {
  std::vector<AttentionBlock> blocks;  // without their conditioning, which is saved
  size_t parts = 1;                    // that attend each within itself, the same number in every block
};

// Returns the parts' outputs one after the other.
torch::Tensor joined(const std::vector<torch::Tensor>& parts) {
  return parts.size() == 1 ? parts.front() : torch::cat(parts);
}

torch::Tensor joined_outputs(const std::vector<AttentionResult>& results) {
  std::vector<torch::Tensor> outputs;
  outputs.reserve(results.size());
  for (const auto& result : results) outputs.push_back(result.output);
  return joined(outputs);
}

class RecomputeBlocks : public torch::autograd::Function<RecomputeBlocks> {
 public:
  static torch::Tensor forward(torch::autograd::AutogradContext* context, const torch::Tensor& x,
                               at::TensorList conditioning, const c10::intrusive_ptr<HeldBlocks>& held) {
    torch::autograd::variable_list saved{x};
    torch::Tensor tokens = x;
    for (size_t i = 0; i < held->blocks.size(); ++i) {
      const AttentionBlock& block = held->blocks[i];
      const auto given = undefined_if_empty(conditioning[i]);
      std::vector<AttentionResult> results;
      for (const auto& inputs : block.inputs(tokens, given))
        results.push_back(fused_attention_result(inputs));
      tokens = block.finish(tokens, joined_outputs(results).view(tokens.sizes()), given);
      saved.push_back(conditioning[i]);
      for (const auto& result : results) saved.insert(saved.end(), {result.output, result.log_sum_exp});
      held->parts = results.size();
    }
    context->save_for_backward(std::move(saved));
    context->saved_data["blocks"] = c10::IValue::make_capsule(held);
    return tokens;
  }

  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 const torch::autograd::variable_list& gradients) {
    const auto saved = context->get_saved_variables();
    const auto held =
        c10::static_intrusive_pointer_cast<HeldBlocks>(context->saved_data["blocks"].toCapsule());
    const size_t count = held->blocks.size();
    const size_t a_block = 1 + 2 * held->parts;
    const auto conditioning = [&](size_t i) { return undefined_if_empty(saved[1 + a_block * i]); };
    const auto attended = [&](size_t i) {
      std::vector<AttentionResult> results;
      for (size_t part = 0; part < held->parts; ++part) {
        const size_t place = 2 + a_block * i + 2 * part;
        results.push_back({saved[place], saved[place + 1]});
      }
      return results;
    };

    // The inputs of all blocks, from the first one's.
    std::vector<torch::Tensor> tokens{saved[0]};
    for (size_t i = 0; i + 1 < count; ++i) {
      const torch::NoGradGuard values_only;
      const auto next = held->blocks[i].finish(tokens[i], joined_outputs(attended(i)).view(tokens[i].sizes()),
                                               conditioning(i));
      tokens.push_back(next.requires_grad_(true));
    }
    torch::Tensor known = gradients[0];
    torch::autograd::variable_list result(2 + count);
    for (size_t i = count; i-- > 0;) {
      const AttentionBlock& block = held->blocks[i];
      const auto kept = attended(i);
      // The attention's output is no leaf of the caller's graph, but its gradient is wanted.
      const auto output = joined_outputs(kept).detach().view(tokens[i].sizes()).requires_grad_(true);
      auto of_finish =
          gradients_of([&](const std::vector<torch::Tensor>& t) { return block.finish(t[0], t[1], t[2]); },
                       {tokens[i], output, conditioning(i)}, known, ViewDependence::kAlone);
      known = torch::Tensor();
      const auto x = leaf_of(tokens[i]);
      const auto given = leaf_of(conditioning(i));
      std::vector<AttentionInputs> inputs;
      {
        const torch::AutoGradMode with_gradients(true);
        inputs = block.inputs(x, given);
      }
      const auto known_parts = of_finish[1].chunk(static_cast<int64_t>(held->parts));
      of_finish[1] = torch::Tensor();
      std::vector<torch::Tensor> attending, attending_gradients;
      for (size_t part = 0; part < held->parts; ++part) {
        const auto inner = fused_attention_gradients(inputs[part], kept[part],
                                                     known_parts[part].view(kept[part].output.sizes()));
        attending.insert(attending.end(), {inputs[part].query, inputs[part].key, inputs[part].value});
        attending_gradients.insert(attending_gradients.end(), {inner.query, inner.key, inner.value});
      }
      torch::autograd::backward(attending, attending_gradients);
      known = added(of_finish[0], x.grad());
      result[1 + i] = added(of_finish[2], gradient_of(given));
      tokens.pop_back();
    }
    result[0] = known;
    return result;
  }
};

// Autograd only comes back to a part through an input with a gradient.
bool records(const torch::Tensor& x, const torch::Tensor& conditioning) {
  return torch::GradMode::is_enabled() &&
         (x.requires_grad() || (conditioning.defined() && conditioning.requires_grad()));
}

torch::Tensor recomputed(const PartFunction& part, const torch::Tensor& x, const torch::Tensor& conditioning,
                         ViewDependence dependence) {
  if (!records(x, conditioning)) return part(x, conditioning);
  auto held = c10::make_intrusive<HeldPart>();
  held->part = part;
  held->dependence = dependence;
  held->autocast = bfloat16_autocast_active(x.device().type());
  return Recompute::apply(x, saveable(conditioning, x), held);
}

torch::Tensor whole_block(const AttentionBlock& block, const torch::Tensor& x,
                          const torch::Tensor& conditioning) {
  std::vector<torch::Tensor> attended;
  for (const auto& inputs : block.inputs(x, conditioning)) attended.push_back(attention(inputs));
  return block.finish(x, joined(attended).view(x.sizes()), conditioning);
}

}  // namespace

torch::Tensor checkpointed(const PartFunction& part, const torch::Tensor& x,
                           const torch::Tensor& conditioning) {
  return recomputed(part, x, conditioning, ViewDependence::kTogether);
}

torch::Tensor checkpointed_by_views(const PartFunction& part, const torch::Tensor& x,
                                    const torch::Tensor& conditioning) {
  return recomputed(part, x, conditioning, ViewDependence::kAlone);
}

torch::Tensor checkpointed(const std::vector<AttentionBlock>& blocks, const torch::Tensor& x) {
  bool kernels = !bfloat16_autocast_active(x.device().type()), recorded = false;
  for (const auto& block : blocks) {
    kernels = kernels && fused_attention_applies(x, block.head_dim);
    recorded = recorded || records(x, block.conditioning);
  }
  if (!recorded || !kernels) {
    torch::Tensor tokens = x;
    for (const auto& block : blocks) {
      const AttentionBlock functions{block.head_dim, block.inputs, block.finish, {}};
      const PartFunction whole = [functions](const torch::Tensor& t, const torch::Tensor& c) {
        return whole_block(functions, t, c);
      };
      tokens = checkpointed(whole, tokens, block.conditioning);
    }
    return tokens;
  }
  auto held = c10::make_intrusive<HeldBlocks>();
  std::vector<torch::Tensor> conditioning;
  for (const auto& block : blocks) {
    conditioning.push_back(saveable(block.conditioning, x));
    held->blocks.push_back({block.head_dim, block.inputs, block.finish, {}});
  }
  // A TensorList, not a vector: only that is searched for tensors with gradients.
  return RecomputeBlocks::apply(x, at::TensorList(conditioning), held);
}

}  // namespace gld
