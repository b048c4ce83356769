#include "models/refiner/unet_attention.h"

#include "gld/attention/attention.h"
#include "models/layers/child_module.h"

namespace gld {
namespace {

constexpr double kLayerNormEpsilon = 1e-5;
constexpr double kGroupNormEpsilon = 1e-6;

}  // namespace

double scored_pairs(int64_t views, double pixels, ViewAttention attention) {
  const auto count = static_cast<double>(views);
  if (attention == ViewAttention::kCross && views > 1) return 2 * (count - 1) * pixels * pixels;
  return count * pixels * count * pixels;
}

UnetAttention::UnetAttention(const UnetAttentionSizes& sizes, const ParameterPlacement& placement)
    : sizes_(sizes) {
  const int64_t channels = sizes.channels;
  norm_ = register_module("norm", std::make_shared<GroupNorm>(
                                      GroupNormSizes{channels, sizes.groups, kGroupNormEpsilon}, placement));
  const auto linear = [&](torch::nn::Module& parent, const char* name, int64_t inputs, int64_t outputs) {
    return parent.register_module(name, std::make_shared<Linear>(LinearSizes{inputs, outputs}, placement));
  };
  proj_in_ = linear(*this, "proj_in", channels, channels);
  const auto block = child_module(*child_module(*this, "transformer_blocks"), "0");
  const auto norm = [&](const char* name) {
    return block->register_module(name, std::make_shared<LayerNorm>(channels, kLayerNormEpsilon, placement));
  };
  norm1_ = norm("norm1");
  pixels_ = projections(*block, "attn1", channels, placement);
  norm2_ = norm("norm2");
  prompt_ = projections(*block, "attn2", sizes.prompt_channels, placement);
  norm3_ = norm("norm3");
  const auto net = child_module(*child_module(*block, "ff"), "net");
  expansion_ = linear(*child_module(*net, "0"), "proj", channels, 8 * channels);
  contraction_ = linear(*net, "2", 4 * channels, channels);
  proj_out_ = linear(*this, "proj_out", channels, channels);
}

UnetAttention::Projections UnetAttention::projections(torch::nn::Module& parent, const char* name,
                                                      int64_t key_channels,
                                                      const ParameterPlacement& placement) const {
  const auto own = child_module(parent, name);
  const auto without_bias = [&](const char* part, int64_t inputs) {
    return own->register_module(
        part, std::make_shared<Linear>(LinearSizes{inputs, sizes_.channels, false}, placement));
  };
  Projections made;
  made.query = without_bias("to_q", sizes_.channels);
  made.key = without_bias("to_k", key_channels);
  made.value = without_bias("to_v", key_channels);
  made.output = child_module(*own, "to_out")
                    ->register_module("0", std::make_shared<Linear>(
                                               LinearSizes{sizes_.channels, sizes_.channels}, placement));
  return made;
}

torch::Tensor UnetAttention::attended(const Projections& by, const torch::Tensor& queries,
                                      const torch::Tensor& keys) const {
  const auto heads = [&](const torch::Tensor& tokens) {
    return tokens.view({tokens.size(0), tokens.size(1), sizes_.heads, -1});
  };
  AttentionInputs inputs;
  inputs.query = heads(by.query->forward(queries));
  inputs.key = heads(by.key->forward(keys));
  inputs.value = heads(by.value->forward(keys));
  inputs.precision = attention_precision_;
  return by.output->forward(attention(inputs).flatten(2));
}

torch::Tensor UnetAttention::over_pixels(const torch::Tensor& tokens, const JoinedViews& joined) const {
  if (joined.views == 1) return attended(pixels_, tokens, tokens);
  const int64_t pixels = tokens.size(1), channels = tokens.size(2);
  const auto views = tokens.view({-1, joined.views, pixels, channels});
  if (joined.attention != ViewAttention::kCross) {
    const auto all = views.flatten(1, 2);
    return attended(pixels_, all, all).view_as(tokens);
  }
  const auto degraded = views.select(1, 0), references = views.slice(1, 1);
  const auto apart = references.reshape({-1, pixels, channels});
  return torch::cat({attended(pixels_, degraded, references.flatten(1, 2)).unsqueeze(1),
                     attended(pixels_, apart, apart).view_as(references)},
                    1)
      .view_as(tokens);
}

torch::Tensor UnetAttention::forward(const torch::Tensor& maps, const torch::Tensor& prompt,
                                     const JoinedViews& joined) const {
  auto tokens = proj_in_->forward(norm_->forward(maps).flatten(2).transpose(1, 2).contiguous());
  tokens = tokens + over_pixels(norm1_->forward(tokens), joined);
  tokens =
      tokens + attended(prompt_, norm2_->forward(tokens), prompt.unsqueeze(0).expand({maps.size(0), -1, -1}));
  const auto gated = expansion_->forward(norm3_->forward(tokens)).chunk(2, -1);
  tokens = tokens + contraction_->forward(gated[0] * torch::gelu(gated[1]));
  return maps + proj_out_->forward(tokens).transpose(1, 2).reshape(maps.sizes());
}

}  // namespace gld
