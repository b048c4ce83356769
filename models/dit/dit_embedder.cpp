#include "models/dit/dit_embedder.h"

#include "gld/tensors/transposed_product.h"

#include <torch/types.h>

namespace gld {
namespace {

// Puts zeros for the target views behind the source views' rows.
torch::Tensor with_target_zeros(const torch::Tensor& source, int64_t views) {
  auto shape = source.sizes().vec();
  shape[0] = views - source.size(0);
  return torch::cat({source, torch::zeros(shape, source.options())}, 0);
}

}  // namespace

DitEmbedder::DitEmbedder(torch::nn::Module& model, const std::string& part, const DitEmbedderSizes& sizes,
                         const ParameterPlacement& placement)
    : sizes_(sizes) {
  const PatchEmbedSizes patch{2 * sizes.in_channels, sizes.width, 1};
  const std::string name = part + "_embedder";
  source_ = model.register_module(sizes.split ? name + "_ref" : name,
                                  std::make_shared<PatchEmbed>(patch, placement));
  if (sizes.split) {
    target_ = model.register_module(name + "_tgt", std::make_shared<PatchEmbed>(patch, placement));
  }
  if (sizes.special_tokens > 0) {
    special_ = model.register_module(
        "special_" + name,
        std::make_shared<Linear>(
            LinearSizes{2 * sizes.in_channels, sizes.width, true, 1, LinearPacking::kNever}, placement));
    special_positions_ =
        model.register_parameter("special_pos_embed_" + part,
                                 torch::empty({1, sizes.special_tokens, sizes.width}, placement.options()));
  }
}

torch::Tensor DitEmbedder::half(const torch::Tensor& weight, EmbedderHalf which) const {
  return weight.flatten(1).narrow(1, which == EmbedderHalf::kSource ? 0 : sizes_.in_channels,
                                  sizes_.in_channels);
}

torch::Tensor DitEmbedder::source_patches(const torch::Tensor& source, int64_t views) const {
  const auto seen = times_transposed(source, half(source_->weight, EmbedderHalf::kSource)) + source_->bias;
  const auto unseen = target().bias.expand({views - source.size(0), source.size(1), sizes_.width});
  return torch::cat({seen, unseen}, 0);
}

torch::Tensor DitEmbedder::target_features(const torch::Tensor& features) const {
  return times_transposed(features, half(target().weight, EmbedderHalf::kSource));
}

torch::Tensor DitEmbedder::latent_patches(const torch::Tensor& latent, int64_t num_sources) const {
  if (!target_) return times_transposed(latent, half(source_->weight, EmbedderHalf::kLatent));
  return torch::cat(
      {times_transposed(latent.narrow(0, 0, num_sources), half(source_->weight, EmbedderHalf::kLatent)),
       times_transposed(latent.narrow(0, num_sources, latent.size(0) - num_sources),
                        half(target_->weight, EmbedderHalf::kLatent))},
      0);
}

torch::Tensor DitEmbedder::patches(const torch::Tensor& source, const torch::Tensor& latent) const {
  const auto joint = torch::cat({with_target_zeros(source, latent.size(0)), latent}, -1);
  if (!target_) return source_->forward_tokens(joint);
  const int64_t sources = source.size(0);
  return torch::cat({source_->forward_tokens(joint.narrow(0, 0, sources)),
                     target_->forward_tokens(joint.narrow(0, sources, joint.size(0) - sources))},
                    0);
}

torch::Tensor DitEmbedder::source_special(const torch::Tensor& source, int64_t views) const {
  return times_transposed(with_target_zeros(source, views), half(special_->weight, EmbedderHalf::kSource)) +
         special_->bias + special_positions_;
}

torch::Tensor DitEmbedder::latent_special(const torch::Tensor& latent) const {
  return times_transposed(latent, half(special_->weight, EmbedderHalf::kLatent));
}

torch::Tensor DitEmbedder::special(const torch::Tensor& source, const torch::Tensor& latent) const {
  const auto joint = torch::cat({with_target_zeros(source, latent.size(0)), latent}, -1);
  return special_->forward(joint) + special_positions_;
}

}  // namespace gld
