#include "models/backbones/backbone.h"

#include "gld/base/error.h"

namespace gld {

LatentGrid BackboneArchitecture::grid_of(int64_t views, int64_t image_height, int64_t image_width) const {
  const int64_t p = patch_side();
  if (image_height < p || image_width < p || image_height % p != 0 || image_width % p != 0) {
    fail({"backbone", "image sides that are positive multiples of " + std::to_string(p) + " pixels",
          std::to_string(image_width) + "x" + std::to_string(image_height), "resize or crop the images"});
  }
  return {views, image_height / p, image_width / p};
}

void Backbone::require_level(int64_t level) const {
  if (level >= 0 && level < architecture().levels()) return;
  fail({"backbone", "a level from 0 to " + std::to_string(architecture().levels() - 1), std::to_string(level),
        "ask for a level that out_layers lists"});
}

void Backbone::require_images(const torch::Tensor& images) const {
  if (images.dim() == 4 && images.size(0) > 0 && images.size(1) == 3) return;
  fail({"backbone", "images (views, 3, height, width)", "a tensor of shape " + c10::str(images.sizes()),
        "give at least one RGB image"});
}

void Backbone::require_propagation_tokens(const PropagationStart& start) const {
  const std::vector<int64_t> expected = {start.grid.views,
                                         architecture().leading_tokens() + start.grid.tokens_per_view(),
                                         architecture().level_channels()};
  if (start.grid.views > 0 && start.tokens.sizes() == expected) return;
  fail({"propagation", "tokens of shape " + c10::str(c10::IntArrayRef(expected)),
        c10::str(start.tokens.sizes()),
        "put the leading tokens in front of the patches of the same token grid"});
}

torch::Tensor Backbone::decode(const torch::Tensor& /*patches*/, const LatentGrid& /*grid*/) const {
  fail({"images", "a backbone that decodes images", "one of kind " + architecture().kind(),
        "use the model's RGB decoder"});
}

Autoencoding Backbone::autoencode(const torch::Tensor& /*images*/,
                                  const torch::Generator& /*generator*/) const {
  fail({"autoencoder", "a backbone that decodes images", "one of kind " + architecture().kind(),
        "train its RGB decoder with gld train decoder"});
}

std::vector<torch::Tensor> Backbone::encode_with_cameras(const torch::Tensor& /*images*/,
                                                         int64_t /*last_level*/,
                                                         const std::vector<Camera>& /*cameras*/,
                                                         std::vector<AttentionTap>* /*taps*/) const {
  fail({"known cameras", "a backbone with an encoder for cameras",
        "one of kind " + architecture().kind() + " without one",
        "use a model that has one, or let it find the cameras itself"});
}

torch::Tensor token_maps(const torch::Tensor& tokens, const LatentGrid& grid) {
  return tokens.transpose(1, 2)
      .reshape({tokens.size(0), tokens.size(2), grid.height, grid.width})
      .to(torch::kCPU);
}

torch::Tensor Backbone::features_of_each(const torch::Tensor& images) const {
  const LatentGrid grid = architecture().grid_of(1, images.size(2), images.size(3));
  std::vector<torch::Tensor> features;
  for (int64_t view = 0; view < images.size(0); ++view) {
    const auto levels = encode(images.narrow(0, view, 1), architecture().levels() - 1);
    features.push_back(token_maps(decodable(levels.back()).patches, grid));
  }
  return torch::cat(features);
}

torch::Tensor Backbone::leading_for_propagation(const torch::Tensor& first_source, int64_t level) const {
  const auto levels = encode(first_source, level);
  return levels.at(static_cast<size_t>(level)).narrow(1, 0, architecture().leading_tokens()).contiguous();
}

torch::Tensor Backbone::patches_of(const torch::Tensor& level) const {
  return level.slice(1, architecture().leading_tokens());
}

DecodableLevel Backbone::decodable(const torch::Tensor& level) const {
  DecodableLevel result;
  result.patches = normalise_for_decoding(patches_of(level));
  result.leading = level.narrow(1, 0, architecture().leading_tokens()).contiguous();
  return result;
}

}  // namespace gld
