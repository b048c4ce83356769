#include "models/layers/vit_block.h"

#include "gld/attention/attention.h"
#include "gld/tensors/fused_ops.h"

#include <memory>

namespace gld {
namespace {

// SwiGLU keeps about the parameter count of the plain layer with two thirds of its width, rounded up to 8.
int64_t swiglu_width(int64_t hidden_dim) { return (hidden_dim * 2 / 3 + 7) / 8 * 8; }

torch::Tensor register_scale(torch::nn::Module& block, const std::string& name, int64_t channels,
                             const ParameterPlacement& placement) {
  auto holder = block.register_module(name, std::make_shared<torch::nn::Module>());
  return holder->register_parameter("gamma", torch::empty({channels}, placement.options()));
}

}  // namespace

VitBlock::VitBlock(const VitBlockSizes& sizes, const ParameterPlacement& placement) : sizes_(sizes) {
  const int64_t channels = sizes.embed_dim;
  norm1_ = register_module("norm1", std::make_shared<LayerNorm>(channels, sizes.norm_epsilon, placement));

  auto attention_part = register_module("attn", std::make_shared<torch::nn::Module>());
  qkv_ = attention_part->register_module(
      "qkv", std::make_shared<Linear>(LinearSizes{channels, 3 * channels}, placement));
  if (sizes.qk_norm) {
    const int64_t head_dim = channels / sizes.num_heads;
    query_norm_ =
        attention_part->register_module("q_norm", std::make_shared<LayerNorm>(head_dim, 1e-5, placement));
    key_norm_ =
        attention_part->register_module("k_norm", std::make_shared<LayerNorm>(head_dim, 1e-5, placement));
  }
  projection_ = attention_part->register_module(
      "proj", std::make_shared<Linear>(LinearSizes{channels, channels}, placement));
  attention_scale_ = register_scale(*this, "ls1", channels, placement);

  norm2_ = register_module("norm2", std::make_shared<LayerNorm>(channels, sizes.norm_epsilon, placement));
  auto feed_forward_part = register_module("mlp", std::make_shared<torch::nn::Module>());
  if (sizes.feed_forward == FeedForward::kMlp) {
    expansion_ = feed_forward_part->register_module(
        "fc1", std::make_shared<Linear>(LinearSizes{channels, sizes.hidden_dim}, placement));
    contraction_ = feed_forward_part->register_module(
        "fc2", std::make_shared<Linear>(LinearSizes{sizes.hidden_dim, channels}, placement));
  } else {
    const int64_t width = swiglu_width(sizes.hidden_dim);
    expansion_ = feed_forward_part->register_module(
        "w12", std::make_shared<Linear>(LinearSizes{channels, 2 * width}, placement));
    contraction_ = feed_forward_part->register_module(
        "w3", std::make_shared<Linear>(LinearSizes{width, channels}, placement));
  }
  feed_forward_scale_ = register_scale(*this, "ls2", channels, placement);
}

torch::Tensor VitBlock::attend(const torch::Tensor& x, AttentionScope scope, const RotaryTables& rotary,
                               AttentionTap* tap) const {
  const int64_t views = x.size(0), tokens = x.size(1), heads = sizes_.num_heads;
  const int64_t head_dim = sizes_.embed_dim / heads;
  const auto qkv = qkv_->forward(x).view({views, tokens, 3, heads, head_dim});
  auto query = qkv.select(2, 0), key = qkv.select(2, 1), value = qkv.select(2, 2);
  if (query_norm_) {
    query = query_norm_->forward(query);
    key = key_norm_->forward(key);
  }
  if (rotary.defined()) {
    query = apply_rotary(query, rotary);
    key = apply_rotary(key, rotary);
  }
  if (scope == AttentionScope::kGlobal) {
    const auto join_views = [&](const torch::Tensor& t) {
      return t.reshape({1, views * tokens, heads, head_dim});
    };
    query = join_views(query);
    key = join_views(key);
    value = join_views(value);
  }
  AttentionInputs inputs;
  inputs.query = query;
  inputs.key = key;
  inputs.value = value;
  inputs.precision = attention_precision_;
  if (tap != nullptr) {
    tap->query = query;
    tap->key = key;
  }
  return projection_->forward(attention(inputs).reshape({views, tokens, sizes_.embed_dim}));
}

torch::Tensor VitBlock::feed_forward(const torch::Tensor& x) const {
  const auto expanded = expansion_->forward(x);
  if (sizes_.feed_forward == FeedForward::kMlp) return contraction_->forward(torch::gelu(expanded));
  return contraction_->forward(silu_gate(expanded));
}

torch::Tensor VitBlock::forward(const torch::Tensor& x, AttentionScope scope, const RotaryTables& rotary,
                                AttentionTap* tap) const {
  const auto attended = torch::addcmul(x, attend(norm1_->forward(x), scope, rotary, tap), attention_scale_);
  return torch::addcmul(attended, feed_forward(norm2_->forward(attended)), feed_forward_scale_);
}

}  // namespace gld
