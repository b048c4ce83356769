#include "models/backbones/dinov2_backbone.h"

#include "gld/base/error.h"
#include "models/layers/imagenet.h"
#include "models/layers/initialisation.h"

#include <algorithm>
#include <functional>
#include <string>

namespace gld {

void Dinov2Sizes::visit_positions(FieldVisitor& visitor) {
  visitor.integer({"num_register_tokens", "register tokens behind the class token"}, num_register_tokens,
                  {0, 1024});
  visitor.boolean({"antialias", "resize the position table with antialiasing"}, positions.antialias);
  visitor.real({"interpolate_offset", "added to the grid's sides where the position table is resized"},
               positions.offset, {0, 1});
}

void Dinov2Sizes::check() const {
  if (embed_dim % num_heads == 0) return;
  fail({"num_heads", "a divisor of embed_dim " + std::to_string(embed_dim), std::to_string(num_heads),
        "change num_heads or embed_dim"});
}

Cost Dinov2Sizes::blocks_cost(const LatentGrid& grid, int64_t count) const {
  const auto width = static_cast<double>(embed_dim);
  const double hidden = width * mlp_ratio;
  const auto views = static_cast<double>(grid.views);
  const auto per_view = static_cast<double>(grid.tokens_per_view() + leading_tokens());
  const double rows = views * per_view;
  Cost cost;
  add_linear(cost, rows, static_cast<double>(3 * patch_size * patch_size), width);
  for (int64_t block = 0; block < count; ++block) {
    add_linear(cost, rows, width, 4 * width);
    add_linear(cost, rows, width, 2 * hidden);
    cost.attention_flop += views * attention_flop(per_view, per_view, width);
  }
  // A block's x, qkv, attention's output and hidden layer, and the levels, raw and normalised.
  cost.working_bytes = bytes_of_floats(rows * (width * 12 + hidden));
  return cost;
}

Dinov2Layers::Dinov2Layers(torch::nn::Module& owner, const Dinov2Sizes& sizes,
                           const ParameterPlacement& placement)
    : sizes_(sizes) {
  sizes_.check();
  const int64_t channels = sizes_.embed_dim;
  const auto empty = [&](const std::vector<int64_t>& shape) {
    return torch::empty(shape, placement.options());
  };
  class_token_ = owner.register_parameter("cls_token", empty({1, 1, channels}));
  if (sizes_.num_register_tokens > 0) {
    register_tokens_ =
        owner.register_parameter("register_tokens", empty({1, sizes_.num_register_tokens, channels}));
  }
  const int64_t positions = sizes_.pos_embed_grid * sizes_.pos_embed_grid;
  position_table_ = owner.register_parameter("pos_embed", empty({1, 1 + positions, channels}));
  owner.register_buffer("mask_token", empty({1, channels}));
  PatchEmbedSizes patch;
  patch.in_channels = 3;
  patch.embed_dim = channels;
  patch.patch_size = sizes_.patch_size;
  patch_embed_ = owner.register_module("patch_embed", std::make_shared<PatchEmbed>(patch, placement));
  auto blocks = owner.register_module("blocks", std::make_shared<torch::nn::Module>());
  VitBlockSizes block;
  block.embed_dim = channels;
  block.num_heads = sizes_.num_heads;
  block.hidden_dim = static_cast<int64_t>(static_cast<double>(channels) * sizes_.mlp_ratio);
  block.feed_forward = sizes_.ffn_layer;
  for (int64_t i = 0; i < sizes_.depth; ++i) {
    blocks_.push_back(
        blocks->register_module(std::to_string(i), std::make_shared<VitBlock>(block, placement)));
  }
  norm_ = owner.register_module("norm", std::make_shared<LayerNorm>(channels, 1e-6, placement));
}

std::vector<torch::Tensor> Dinov2Layers::forward(const torch::Tensor& images,
                                                 const std::vector<int64_t>& blocks) const {
  const int64_t views = images.size(0), channels = sizes_.embed_dim;
  const LatentGrid grid = {views, images.size(2) / sizes_.patch_size, images.size(3) / sizes_.patch_size};
  const auto patches = patch_embed_->forward_image(imagenet_normalise(images));
  const auto placed = torch::cat({class_token_.expand({views, 1, channels}), patches}, 1) +
                      resized_positions(position_table_, grid, sizes_.positions);
  std::vector<torch::Tensor> tokens = {placed.narrow(1, 0, 1)};
  if (register_tokens_.defined()) {
    tokens.push_back(register_tokens_.expand({views, sizes_.num_register_tokens, channels}));
  }
  tokens.push_back(placed.slice(1, 1));
  auto x = torch::cat(tokens, 1);
  std::vector<torch::Tensor> outputs;
  for (int64_t i = 0; i <= blocks.back(); ++i) {
    x = blocks_[static_cast<size_t>(i)]->forward(x, AttentionScope::kLocal, {});
    if (std::find(blocks.begin(), blocks.end(), i) != blocks.end()) outputs.push_back(norm_->forward(x));
  }
  return outputs;
}

void Dinov2Options::visit(FieldVisitor& visitor) {
  visitor.integer({"patch_size", "side of a patch in pixels"}, sizes.patch_size, {1, 1024});
  visitor.integer({"embed_dim", "channels of a token"}, sizes.embed_dim, {4, 1 << 16});
  visitor.integer({"depth", "number of blocks"}, sizes.depth, {1, 1024});
  visitor.integer({"num_heads", "attention heads"}, sizes.num_heads, {1, 1024});
  visitor.real({"mlp_ratio", "width of the feed-forward part over embed_dim"}, sizes.mlp_ratio, {0.01, 64});
  visit_choice(visitor, {"ffn_layer", "feed-forward part; both swiglu names mean the same layer"},
               sizes.ffn_layer, {"mlp", "swiglu", "swiglufused"});
  visitor.integer({"pos_embed_grid", "rows and columns of the stored position table"}, sizes.pos_embed_grid,
                  {1, 4096});
  sizes.visit_positions(visitor);
  visitor.integers(
      {"out_layers", "blocks after which levels 0, 1, ... are taken, ascending; none is the last"},
      out_layers, {0, 1023});
}

void Dinov2Options::check() const {
  sizes.check();
  const bool ascending =
      std::adjacent_find(out_layers.begin(), out_layers.end(), std::greater_equal<>()) == out_layers.end();
  if (!ascending || level_blocks().back() >= sizes.depth) {
    fail({"out_layers", "ascending block numbers below depth " + std::to_string(sizes.depth),
          c10::str(c10::IntArrayRef(out_layers)), "list the blocks after which the levels are taken"});
  }
}

std::unique_ptr<BackboneArchitecture> Dinov2Options::copy() const {
  return std::make_unique<Dinov2Options>(*this);
}

std::shared_ptr<Backbone> Dinov2Options::make(const ParameterPlacement& placement) const {
  return std::make_shared<Dinov2Backbone>(*this, placement);
}

Cost Dinov2Options::encoding_cost(const LatentGrid& grid, int64_t last_level) const {
  return sizes.blocks_cost(grid, level_blocks().at(static_cast<size_t>(last_level)) + 1);
}

Dinov2Backbone::Dinov2Backbone(const Dinov2Options& options, const ParameterPlacement& placement)
    : options_((options.check(), options)), layers_(*this, options.sizes, placement) {}

std::vector<torch::Tensor> Dinov2Backbone::encode(const torch::Tensor& images, int64_t last_level,
                                                  std::vector<AttentionTap>* /*taps*/) const {
  require_level(last_level);
  require_images(images);
  auto blocks = options_.level_blocks();
  blocks.resize(static_cast<size_t>(last_level) + 1);
  return layers_.forward(images, blocks);
}

std::vector<DecodableLevel> Dinov2Backbone::propagate(const PropagationStart& start) const {
  require_level(start.level);
  require_propagation_tokens(start);
  return {decodable(start.tokens)};
}

torch::Tensor Dinov2Backbone::normalise_for_decoding(const torch::Tensor& patches) const { return patches; }

void Dinov2Backbone::initialise(const torch::Generator& generator) {
  initialise_parameters(*this, MatrixInitialisation::kTruncatedNormal, generator);
  torch::NoGradGuard no_grad;
  for (auto& buffer : buffers()) buffer.zero_();
}

}  // namespace gld
