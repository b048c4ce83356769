#include "bench/kernels/composed_dit.h"

#include "gld/attention/composed_attention.h"
#include "gld/base/error.h"

#include <torch/types.h>

namespace gld {
namespace {

constexpr double kEpsilon = 1e-6;

// The scene must have been prepared with its tables (the default savings).
const DitBranchCameras& cameras_of(const DitScene& scene, DitBranch branch) {
  const auto& cameras = scene.branches[static_cast<std::size_t>(branch)];
  if (!cameras.encoder_prope.query_matrix.defined() || !cameras.embedded) {
    fail({"composed DiT", "a scene prepared with camera embedding and PRoPE tables", "one without",
          "prepare it with the default exact savings"});
  }
  return cameras;
}

const DitPass& only_pass(const DitPasses& passes) {
  if (passes.size() != 1) {
    fail({"composed DiT", "one scene in one branch", std::to_string(passes.size()) + " passes", "give one"});
  }
  return passes.front();
}

}  // namespace

ComposedDit::ComposedDit(const DitDh& model) : model_(model) {
  for (const auto& parameter : model.named_parameters(/*recurse=*/true)) {
    parameters_.emplace(parameter.key(), parameter.value());
  }
}

torch::Tensor ComposedDit::linear(const std::string& name, const torch::Tensor& x) const {
  return torch::matmul(x, parameters_.at(name + ".weight").t()) + parameters_.at(name + ".bias");
}

torch::Tensor ComposedDit::rms_norm(const std::string& name, const torch::Tensor& x) const {
  return x * torch::rsqrt(x.square().mean(-1, /*keepdim=*/true) + kEpsilon) *
         parameters_.at(name + ".weight");
}

torch::Tensor ComposedDit::block(int64_t index, int64_t heads, const torch::Tensor& x,
                                 const torch::Tensor& modulation, const PropeTables& prope) const {
  const std::string name = "blocks." + std::to_string(index);
  const int64_t views = x.size(0), tokens = x.size(1), channels = x.size(2);
  const auto parts = modulation.chunk(6, -1);
  const auto qkv = linear(name + ".attn.qkv", rms_norm(name + ".norm1", x) * (1.0 + parts[1]) + parts[0])
                       .view({1, views * tokens, 3, heads, channels / heads});
  AttentionInputs inputs;
  inputs.query = qkv.select(2, 0);
  inputs.key = qkv.select(2, 1);
  inputs.value = qkv.select(2, 2);
  if (model_.options().qk_norm) {
    inputs.query = rms_norm(name + ".attn.q_norm", inputs.query);
    inputs.key = rms_norm(name + ".attn.k_norm", inputs.key);
  }
  inputs.prope = &prope;
  const auto attended = composed_attention(inputs).view({views, tokens, channels});
  const auto middle = x + parts[2] * linear(name + ".attn.proj", attended);
  const auto halves =
      linear(name + ".mlp.w12", rms_norm(name + ".norm2", middle) * (1.0 + parts[4]) + parts[3]).chunk(2, -1);
  return middle + parts[5] * linear(name + ".mlp.w3", torch::silu(halves[0]) * halves[1]);
}

torch::Tensor ComposedDit::condition_encoder(const DitPasses& passes, const DitNoisyTokens& tokens) const {
  const auto& [scene, time, branch] = only_pass(passes);
  const auto& options = model_.options();
  const auto& cameras = cameras_of(*scene, branch);
  auto x = tokens.encoder;
  if (cameras.encoder_embedding.defined()) x = x + cameras.encoder_embedding;
  for (int64_t i = 0; i < options.encoder_blocks(); ++i) {
    const auto modulation = time->encoder_modulation[static_cast<std::size_t>(i)].unsqueeze(1);
    x = block(i, options.num_heads[0], x, modulation, cameras.encoder_prope);
  }
  return x;
}

torch::Tensor ComposedDit::velocity_features(const DitPasses& passes, const DitNoisyTokens& tokens,
                                             const torch::Tensor& condition) const {
  const auto& [scene, time, branch] = only_pass(passes);
  const auto& options = model_.options();
  const auto& cameras = cameras_of(*scene, branch);
  auto s = torch::silu(condition + time->embedding.unsqueeze(1));
  if (options.encoder_width() != options.decoder_width()) s = linear("s_projector", s);
  const auto activation = torch::silu(s);
  auto x = tokens.decoder;
  if (cameras.decoder_embedding.defined()) x = x + cameras.decoder_embedding;
  for (int64_t i = 0; i < options.decoder_blocks(); ++i) {
    const int64_t index = options.encoder_blocks() + i;
    const auto modulation = linear("blocks." + std::to_string(index) + ".adaLN_modulation.1", activation);
    x = block(index, options.num_heads[1], x, modulation, cameras.decoder_prope);
  }
  const auto parts = linear("final_layer.adaLN_modulation.1", activation).chunk(2, -1);
  return model_.with_first_guess(passes, rms_norm("final_layer.norm_final", x) * (1.0 + parts[1]) + parts[0]);
}

}  // namespace gld
