#include "models/decoders/rgb_decoder.h"

#include "gld/attention/attention.h"
#include "gld/base/error.h"
#include "models/decoders/pixel_refinement.h"
#include "models/layers/imagenet.h"
#include "models/layers/initialisation.h"

#include <algorithm>
#include <string>

#include <torch/autograd.h>

namespace gld {
namespace {

// Returns sine-cosine positions of a square grid (ViT-MAE): (grid^2, channels), the first half of the channels from the
// column, the second from the row, each sines then cosines at base 10000.
torch::Tensor sine_cosine_positions(int64_t grid, int64_t channels) {
  const auto exponents = torch::arange(channels / 4, torch::kFloat64) / (static_cast<double>(channels) / 4);
  const auto frequencies = torch::pow(10000.0, exponents).reciprocal();
  const auto angles = torch::arange(grid, torch::kFloat64).unsqueeze(1) * frequencies.unsqueeze(0);
  const auto waves = torch::cat({angles.sin(), angles.cos()}, 1);  // (grid, channels / 2)
  return torch::cat({waves.repeat({grid, 1}), waves.repeat_interleave(grid, 0)}, 1);
}

}  // namespace

void RgbDecoderOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"in_channels", "channels of the four levels together"}, in_channels, {1, 1 << 18});
  visitor.integer({"hidden_size", "channels of a token, divisible by 4"}, hidden_size, {4, 1 << 16});
  visitor.integer({"num_layers", "transformer layers"}, num_layers, {1, 1024});
  visitor.integer({"num_heads", "attention heads"}, num_heads, {1, 1024});
  visitor.integer({"intermediate_size", "width of the feed-forward part"}, intermediate_size, {1, 1 << 18});
  visitor.integer({"patch_size", "side of a patch in pixels"}, patch_size, {1, 1024});
  visitor.integer({"base_image_size", "side in pixels of the image whose positions are stored"},
                  base_image_size, {1, 1 << 16});
  visitor.real({"layer_norm_eps", "epsilon of the layer norms"}, layer_norm_eps, {0, 1});
  visitor.integer({"refinement_channels",
                   "channels of convolutions that refine the drawn pixels; 0 for none, as published"},
                  refinement_channels, {0, 4096});
  visitor.integer({"refinement_layers", "how many convolutions refine them"}, refinement_layers, {2, 64});
}

void RgbDecoderOptions::check() const {
  if (hidden_size % num_heads != 0 || hidden_size % 4 != 0) {
    fail({"hidden_size", "a multiple of num_heads " + std::to_string(num_heads) + " and of 4",
          std::to_string(hidden_size), "change hidden_size or num_heads"});
  }
  if (base_image_size % patch_size != 0) {
    fail({"base_image_size", "a multiple of patch_size " + std::to_string(patch_size),
          std::to_string(base_image_size), "change base_image_size or patch_size"});
  }
}

RgbDecoderLayer::RgbDecoderLayer(const RgbDecoderOptions& options, const ParameterPlacement& placement)
    : num_heads_(options.num_heads) {
  const int64_t channels = options.hidden_size;
  const auto linear = [&](const std::shared_ptr<torch::nn::Module>& parent, const char* name, int64_t inputs,
                          int64_t outputs) {
    return parent->register_module(name, std::make_shared<Linear>(LinearSizes{inputs, outputs}, placement));
  };
  const auto child = [](torch::nn::Module& parent, const char* name) {
    return parent.register_module(name, std::make_shared<torch::nn::Module>());
  };
  norm_before_ = register_module("layernorm_before",
                                 std::make_shared<LayerNorm>(channels, options.layer_norm_eps, placement));
  const auto attention_part = child(*this, "attention");
  const auto self = child(*attention_part, "attention");
  query_ = linear(self, "query", channels, channels);
  key_ = linear(self, "key", channels, channels);
  value_ = linear(self, "value", channels, channels);
  projection_ = linear(child(*attention_part, "output"), "dense", channels, channels);
  norm_after_ = register_module("layernorm_after",
                                std::make_shared<LayerNorm>(channels, options.layer_norm_eps, placement));
  expansion_ = linear(child(*this, "intermediate"), "dense", channels, options.intermediate_size);
  contraction_ = linear(child(*this, "output"), "dense", options.intermediate_size, channels);
}

torch::Tensor RgbDecoderLayer::attend(const torch::Tensor& x) const {
  const int64_t views = x.size(0), tokens = x.size(1), head_dim = x.size(2) / num_heads_;
  const auto heads = [&](const Linear& layer) {
    return layer.forward(x).view({views, tokens, num_heads_, head_dim});
  };
  AttentionInputs inputs;
  inputs.query = heads(*query_);
  inputs.key = heads(*key_);
  inputs.value = heads(*value_);
  inputs.precision = attention_precision_;
  return projection_->forward(attention(inputs).view({views, tokens, x.size(2)}));
}

torch::Tensor RgbDecoderLayer::forward(const torch::Tensor& x) const {
  const auto attended = x + attend(norm_before_->forward(x));
  return attended + contraction_->forward(torch::gelu(expansion_->forward(norm_after_->forward(attended))));
}

RgbDecoder::RgbDecoder(const RgbDecoderOptions& options, const ParameterPlacement& placement)
    : options_(options) {
  options_.check();
  const int64_t channels = options_.hidden_size;
  embedding_ = register_module(
      "decoder_embed", std::make_shared<Linear>(LinearSizes{options_.in_channels, channels}, placement));
  auto layers = register_module("decoder_layers", std::make_shared<torch::nn::Module>());
  for (int64_t i = 0; i < options_.num_layers; ++i) {
    layers_.push_back(
        layers->register_module(std::to_string(i), std::make_shared<RgbDecoderLayer>(options_, placement)));
  }
  norm_ = register_module("decoder_norm",
                          std::make_shared<LayerNorm>(channels, options_.layer_norm_eps, placement));
  prediction_ = register_module(
      "decoder_pred",
      std::make_shared<Linear>(LinearSizes{channels, options_.patch_values(), true, 1, LinearPacking::kNever},
                               placement));
  if (options_.refinement_channels > 0) {
    refinement_ = register_module(
        "refinement",
        std::make_shared<PixelRefinement>(
            PixelRefinement::Sizes{options_.refinement_channels, options_.refinement_layers}, placement));
  }
  class_token_ =
      register_parameter("trainable_cls_token", torch::empty({1, 1, channels}, placement.options()));
  const int64_t positions = 1 + options_.base_grid() * options_.base_grid();
  position_table_ =
      register_buffer("decoder_pos_embed", torch::empty({1, positions, channels}, placement.options()));
}

torch::Tensor RgbDecoder::position_embedding(const LatentGrid& grid) const {
  const int64_t side = options_.base_grid();
  if (grid.height == side && grid.width == side) return position_table_;
  const auto patches =
      position_table_.slice(1, 1).view({1, side, side, options_.hidden_size}).permute({0, 3, 1, 2});
  const auto resized = torch::upsample_bicubic2d(patches, {grid.height, grid.width}, /*align_corners=*/false);
  return torch::cat({position_table_.slice(1, 0, 1), resized.flatten(2).transpose(1, 2)}, 1);
}

torch::Tensor RgbDecoder::logits(const torch::Tensor& features, const LatentGrid& grid) const {
  const std::vector<int64_t> expected = {grid.views, grid.tokens_per_view(), options_.in_channels};
  if (grid.views <= 0 || grid.tokens_per_view() <= 0 || features.sizes() != expected) {
    fail({"RGB decoder", "features of shape " + c10::str(c10::IntArrayRef(expected)),
          c10::str(features.sizes()), "concatenate the four decodable levels on channels"});
  }
  const auto positions = position_embedding(grid);
  const int64_t chunk = std::max<int64_t>(1, kTokensPerChunk / (1 + grid.tokens_per_view()));
  std::vector<torch::Tensor> parts;
  for (int64_t first = 0; first < grid.views; first += chunk) {
    const int64_t count = std::min(chunk, grid.views - first);
    const auto embedded = embedding_->forward(features.narrow(0, first, count));
    auto tokens =
        torch::cat({class_token_.expand({count, 1, options_.hidden_size}), embedded}, 1) + positions;
    for (const auto& layer : layers_) tokens = layer->forward(tokens);
    parts.push_back(prediction_->forward(norm_->forward(tokens.slice(1, 1))));
  }
  return torch::cat(parts);
}

torch::Tensor RgbDecoder::unpatchify(const torch::Tensor& logits, const LatentGrid& grid) const {
  const int64_t p = options_.patch_size;
  return logits.reshape({grid.views, grid.height, grid.width, p, p, 3})
      .permute({0, 5, 1, 3, 2, 4})
      .reshape({grid.views, 3, grid.height * p, grid.width * p});
}

torch::Tensor RgbDecoder::decode(const torch::Tensor& features, const LatentGrid& grid) const {
  const auto drawn = unpatchify(logits(features, grid), grid);
  return imagenet_denormalise(refinement_ ? refinement_->forward(drawn) : drawn);
}

void RgbDecoder::initialise(const torch::Generator& generator) {
  torch::NoGradGuard no_grad;
  initialise_parameters(*this, MatrixInitialisation::kXavierUniform, generator);
  if (refinement_) refinement_->initialise(generator);
  class_token_.zero_();
  position_table_.zero_();
  position_table_.slice(1, 1).copy_(
      sine_cosine_positions(options_.base_grid(), options_.hidden_size).unsqueeze(0));
}

}  // namespace gld
