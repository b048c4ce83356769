#include "models/dit/dit_block.h"

#include "gld/attention/attention.h"
#include "gld/tensors/fused_ops.h"

#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

constexpr double kEpsilon = 1e-6;

// Vectors of a block's AdaLN, in the order of the checkpoint.
constexpr int64_t kAttentionShift = 0;
constexpr int64_t kAttentionGate = 2;
constexpr int64_t kFeedForwardShift = 3;

// Returns x normalised and modulated by the first two of an AdaLN's vectors, shift and scale.
torch::Tensor modulated(const RmsNorm& norm, const torch::Tensor& x,
                        const std::vector<torch::Tensor>& vectors) {
  RmsNormInputs inputs;
  inputs.x = x;
  inputs.weight = norm.weight;
  inputs.epsilon = norm.epsilon();
  inputs.shift = vectors[0];
  inputs.scale = vectors[1];
  return rms_norm(inputs);
}

}  // namespace

DitBlock::DitBlock(const DitBlockSizes& sizes, const ParameterPlacement& placement) : sizes_(sizes) {
  const int64_t channels = sizes.channels;
  norm1_ = register_module("norm1", std::make_shared<RmsNorm>(channels, kEpsilon, placement));
  norm2_ = register_module("norm2", std::make_shared<RmsNorm>(channels, kEpsilon, placement));
  auto attention_part = register_module("attn", std::make_shared<torch::nn::Module>());
  qkv_ = attention_part->register_module(
      "qkv", std::make_shared<Linear>(LinearSizes{channels, 3 * channels}, placement));
  if (sizes.qk_norm) {
    const int64_t head_dim = channels / sizes.num_heads;
    query_norm_ =
        attention_part->register_module("q_norm", std::make_shared<RmsNorm>(head_dim, kEpsilon, placement));
    key_norm_ =
        attention_part->register_module("k_norm", std::make_shared<RmsNorm>(head_dim, kEpsilon, placement));
  }
  projection_ = attention_part->register_module(
      "proj", std::make_shared<Linear>(LinearSizes{channels, channels}, placement));
  feed_forward_ =
      register_module("mlp", std::make_shared<Swiglu>(SwigluSizes{channels, sizes.swiglu_width}, placement));
  adaptive_norm_ =
      register_module("adaLN_modulation", std::make_shared<AdaptiveNorm>(channels, 6, placement));
}

torch::Tensor DitBlock::modulation_rows(const torch::Tensor& activation) const {
  return adaptive_norm_->rows(activation);
}

std::vector<AttentionInputs> DitBlock::attention_inputs(const torch::Tensor& x,
                                                        const DitBlockContext& context) const {
  const int64_t views = x.size(0), tokens = x.size(1), heads = sizes_.num_heads;
  const auto passes = static_cast<int64_t>(context.passes.size());
  const int64_t head_dim = sizes_.channels / heads;
  const auto qkv = by_view_groups(x, [&](const ViewGroup& group) {
                     const auto vectors =
                         adaptive_norm_->parts(context.modulation, group, kAttentionShift, 2);
                     return qkv_->forward(modulated(*norm1_, x.narrow(0, group.first, group.count), vectors));
                   }).view({passes, views / passes * tokens, 3, heads, head_dim});
  AttentionInputs inputs;
  inputs.query = qkv.select(2, 0);
  inputs.key = qkv.select(2, 1);
  inputs.value = qkv.select(2, 2);
  if (sizes_.qk_norm) {
    inputs.query = query_norm_->forward(inputs.query);
    inputs.key = key_norm_->forward(inputs.key);
  }
  inputs.precision = attention_precision_;
  std::vector<AttentionInputs> result;
  for (int64_t pass = 0; pass < passes; ++pass) {
    result.push_back(inputs);
    for (auto* tensor : {&result.back().query, &result.back().key, &result.back().value}) {
      *tensor = tensor->narrow(0, pass, 1);
    }
    result.back().prope = context.passes[static_cast<size_t>(pass)].prope;
  }
  return result;
}

torch::Tensor DitBlock::finish(const torch::Tensor& x, const torch::Tensor& attended,
                               const DitBlockContext& context) const {
  const auto tokens = attended.view(x.sizes());
  return by_view_groups(x, [&](const ViewGroup& group) {
    const auto gate = adaptive_norm_->parts(context.modulation, group, kAttentionGate, 1);
    const auto middle = gated_sum(x.narrow(0, group.first, group.count), gate[0],
                                  projection_->forward(tokens.narrow(0, group.first, group.count)));
    const auto vectors = adaptive_norm_->parts(context.modulation, group, kFeedForwardShift, 3);
    return gated_sum(middle, vectors[2], feed_forward_->forward(modulated(*norm2_, middle, vectors)));
  });
}

torch::Tensor DitBlock::forward(const torch::Tensor& x, const DitBlockContext& context) const {
  std::vector<torch::Tensor> attended;
  for (const auto& inputs : attention_inputs(x, context)) {
    if (AttentionTap* tap = context.passes[attended.size()].tap) {
      tap->query = encode_query(*inputs.prope, inputs.query);
      tap->key = encode_key_value(*inputs.prope, inputs.key);
    }
    attended.push_back(attention(inputs));
  }
  return finish(x, attended.size() == 1 ? attended.front() : torch::cat(attended), context);
}

DitFinalLayer::DitFinalLayer(const DitFinalLayerSizes& sizes, const ParameterPlacement& placement) {
  norm_ = register_module("norm_final", std::make_shared<RmsNorm>(sizes.channels, kEpsilon, placement));
  linear_ = register_module(
      "linear", std::make_shared<Linear>(
                    LinearSizes{sizes.channels, sizes.outputs, true, 1, LinearPacking::kNever}, placement));
  adaptive_norm_ =
      register_module("adaLN_modulation", std::make_shared<AdaptiveNorm>(sizes.channels, 2, placement));
}

torch::Tensor DitFinalLayer::features(const torch::Tensor& x, const Modulation& modulation) const {
  return by_view_groups(x, [&](const ViewGroup& group) {
    const auto vectors = adaptive_norm_->parts(modulation, group, 0, 2);
    return modulated(*norm_, x.narrow(0, group.first, group.count), vectors);
  });
}

torch::Tensor DitFinalLayer::project(const torch::Tensor& features) const {
  return linear_->forward(features);
}

}  // namespace gld
