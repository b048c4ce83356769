#include "models/backbones/da3_backbone.h"

#include "gld/base/error.h"
#include "models/layers/imagenet.h"
#include "models/layers/initialisation.h"
#include "models/layers/position_embedding.h"

#include <algorithm>
#include <string>

#include <torch/autograd.h>

namespace gld {

void Da3BackboneOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"patch_size", "side of a patch in pixels"}, patch_size, {1, 1024});
  visitor.integer({"embed_dim", "channels of a token"}, embed_dim, {4, 1 << 16});
  visitor.integer({"depth", "number of blocks"}, depth, {1, 1024});
  visitor.integer({"num_heads", "attention heads"}, num_heads, {1, 1024});
  visitor.real({"mlp_ratio", "width of the feed-forward part over embed_dim"}, mlp_ratio, {0.01, 64});
  visit_choice(visitor, {"ffn_layer", "feed-forward part; both swiglu names mean the same layer"}, ffn_layer,
               {"mlp", "swiglu", "swiglufused"});
  visitor.integer({"pos_embed_grid", "rows and columns of the stored position table"}, pos_embed_grid,
                  {1, 4096});
  visitor.integers({"out_layers", "blocks after which levels 0, 1, ... are taken, ascending"}, out_layers,
                   {0, 1023});
  visitor.integer({"alternating_start", "first block from which odd blocks attend over all views; -1: none"},
                  alternating_start, {-1, 1024});
  visitor.integer({"qk_norm_start", "first block with query and key norms; -1: none"}, qk_norm_start,
                  {-1, 1024});
  visitor.integer({"rope_start", "first block with rotary positions; -1: none"}, rope_start, {-1, 1024});
  visitor.real({"rope_frequency", "base of the rotary frequencies; 0: no rotary positions"}, rope_frequency,
               {0, 1e9});
  visitor.integer({"camera_encoder_depth", "blocks of the encoder of known cameras; 0: the model has none"},
                  camera_encoder_depth, {0, 1024});
  visitor.integer({"camera_encoder_heads", "attention heads of that encoder"}, camera_encoder_heads,
                  {1, 1024});
}

void Da3BackboneOptions::check() const {
  if (embed_dim % num_heads != 0) {
    fail({"num_heads", "a divisor of embed_dim " + std::to_string(embed_dim), std::to_string(num_heads),
          "change num_heads or embed_dim"});
  }
  if (rope_start >= 0 && rope_frequency > 0 && (embed_dim / num_heads) % 4 != 0) {
    fail({"num_heads", "a head size divisible by 4 for rotary positions",
          std::to_string(embed_dim / num_heads), "change num_heads, or set rope_start: -1"});
  }
  if (takes_cameras() && embed_dim % camera_encoder_heads != 0) {
    fail({"camera_encoder_heads", "a divisor of embed_dim " + std::to_string(embed_dim),
          std::to_string(camera_encoder_heads), "change camera_encoder_heads"});
  }
  if (takes_cameras() && alternating_start < 0) {
    fail({"camera_encoder_depth", "0 where no block attends over all views (alternating_start: -1)",
          std::to_string(camera_encoder_depth), "set it to 0: such a model has no camera token"});
  }
  const bool ascending =
      std::adjacent_find(out_layers.begin(), out_layers.end(), std::greater_equal<>()) == out_layers.end();
  if (out_layers.empty() || !ascending || out_layers.back() >= depth) {
    fail({"out_layers", "ascending block numbers below depth " + std::to_string(depth),
          c10::str(c10::IntArrayRef(out_layers)), "list the blocks after which the levels are taken"});
  }
}

std::unique_ptr<BackboneArchitecture> Da3BackboneOptions::copy() const {
  return std::make_unique<Da3BackboneOptions>(*this);
}

std::shared_ptr<Backbone> Da3BackboneOptions::make(const ParameterPlacement& placement) const {
  return std::make_shared<Da3Backbone>(*this, placement);
}

Cost Da3BackboneOptions::blocks_cost(const LatentGrid& grid, int64_t first_block, int64_t last_block) const {
  const auto width = static_cast<double>(embed_dim);
  const auto hidden = width * mlp_ratio;
  const int64_t tokens_per_view = grid.tokens_per_view() + 1;
  const auto views = static_cast<double>(grid.views), per_view = static_cast<double>(tokens_per_view);
  const double rows = views * per_view;
  Cost cost;
  for (int64_t block = first_block; block < last_block; ++block) {
    add_linear(cost, rows, width, 4 * width);
    add_linear(cost, rows, width, 2 * hidden);
    cost.attention_flop += attends_over_views(block) ? gld::attention_flop(rows, rows, width)
                                                     : views * gld::attention_flop(per_view, per_view, width);
  }
  if (first_block == 0) {
    const auto patch_values = static_cast<double>(3 * patch_size * patch_size);
    add_linear(cost, rows, patch_values, width);
  }
  // The levels raw, contiguous and normalised (2 widths each) and a block's x, qkv, attention's output and hidden
  // layer: 22 widths are what runs took with two and with four levels, to a fifth.
  cost.working_bytes = bytes_of_floats(rows * (width * 22 + hidden));
  return cost;
}

Cost Da3BackboneOptions::encoding_cost(const LatentGrid& grid, int64_t last_level) const {
  return blocks_cost(grid, 0, out_layers.at(static_cast<size_t>(last_level)) + 1);
}

Cost Da3BackboneOptions::propagation_cost(const LatentGrid& grid, int64_t level) const {
  return blocks_cost(grid, out_layers.at(static_cast<size_t>(level)) + 1, out_layers.back() + 1);
}

Da3Backbone::Da3Backbone(const Da3BackboneOptions& options, const ParameterPlacement& placement)
    : options_(options) {
  options_.check();
  const int64_t channels = options_.embed_dim;
  const auto parameter = [&](const char* name, const std::vector<int64_t>& shape) {
    return register_parameter(name, torch::empty(shape, placement.options()));
  };
  class_token_ = parameter("cls_token", {1, 1, channels});
  if (options_.alternating_start >= 0) camera_token_ = parameter("camera_token", {1, 2, channels});
  position_table_ =
      parameter("pos_embed", {1, 1 + options_.pos_embed_grid * options_.pos_embed_grid, channels});

  PatchEmbedSizes patch_sizes;
  patch_sizes.in_channels = 3;
  patch_sizes.embed_dim = channels;
  patch_sizes.patch_size = options_.patch_size;
  patch_embed_ = register_module("patch_embed", std::make_shared<PatchEmbed>(patch_sizes, placement));

  auto blocks = register_module("blocks", std::make_shared<torch::nn::Module>());
  for (int64_t i = 0; i < options_.depth; ++i) {
    VitBlockSizes sizes;
    sizes.embed_dim = channels;
    sizes.num_heads = options_.num_heads;
    sizes.hidden_dim = static_cast<int64_t>(static_cast<double>(channels) * options_.mlp_ratio);
    sizes.feed_forward = options_.ffn_layer;
    sizes.qk_norm = options_.qk_norm_start >= 0 && i >= options_.qk_norm_start;
    blocks_.push_back(
        blocks->register_module(std::to_string(i), std::make_shared<VitBlock>(sizes, placement)));
  }
  if (options_.takes_cameras()) {
    const CameraEncoderSizes sizes{channels, options_.camera_encoder_depth, options_.camera_encoder_heads};
    camera_encoder_ = register_module("cam_enc", std::make_shared<CameraEncoder>(sizes, placement));
  }
  norm_ = register_module("norm", std::make_shared<LayerNorm>(channels, 1e-5, placement));
}

torch::Tensor Da3Backbone::position_embedding(const LatentGrid& grid) const {
  return resized_positions(position_table_, grid, PositionResizing());
}

torch::Tensor Da3Backbone::with_camera_tokens(const TokenState& state) const {
  const auto& tokens = state.current;
  if (state.camera_tokens.defined()) return torch::cat({state.camera_tokens, tokens.slice(1, 1)}, 1);
  const int64_t views = tokens.size(0);
  const auto first = camera_token_.slice(1, 0, 1);
  const auto others = camera_token_.slice(1, 1, 2).expand({views - 1, 1, options_.embed_dim});
  return torch::cat({torch::cat({first, others}), tokens.slice(1, 1)}, 1);
}

std::vector<torch::Tensor> Da3Backbone::run_blocks(TokenState state, int64_t first_block, int64_t last_level,
                                                   const LatentGrid& grid,
                                                   std::vector<AttentionTap>* taps) const {
  RotaryTables local_tables, global_tables;
  if (options_.rope_start >= 0 && options_.rope_frequency > 0) {
    RotaryGrid rotary_grid;
    rotary_grid.height = grid.height;
    rotary_grid.width = grid.width;
    rotary_grid.head_dim = options_.embed_dim / options_.num_heads;
    rotary_grid.frequency = options_.rope_frequency;
    local_tables = local_rotary_tables(rotary_grid, state.current.options());
    global_tables = global_rotary_tables(rotary_grid, state.current.options());
  }
  std::vector<torch::Tensor> levels;
  const int64_t last_block = options_.out_layers[static_cast<size_t>(last_level)];
  for (int64_t i = first_block; i <= last_block; ++i) {
    if (i == options_.alternating_start) state.current = with_camera_tokens(state);
    const bool global = options_.attends_over_views(i);
    const bool turned = options_.rope_start >= 0 && i >= options_.rope_start;
    const RotaryTables none;
    const RotaryTables& tables = !turned ? none : global ? global_tables : local_tables;
    const auto& block = *blocks_[static_cast<size_t>(i)];
    AttentionTap* wanted = nullptr;
    if (taps != nullptr && global) {
      for (AttentionTap& tap : *taps) wanted = tap.block == i ? &tap : wanted;
    }
    state.current = block.forward(state.current, global ? AttentionScope::kGlobal : AttentionScope::kLocal,
                                  tables, wanted);
    if (!global) state.local = state.current;
    if (std::find(options_.out_layers.begin(), options_.out_layers.end(), i) != options_.out_layers.end()) {
      levels.push_back(torch::cat({state.local, state.current}, -1));
    }
  }
  return levels;
}

std::vector<torch::Tensor> Da3Backbone::encode(const torch::Tensor& images, int64_t last_level,
                                               std::vector<AttentionTap>* taps) const {
  return encode_with_tokens(images, last_level, {}, taps);
}

torch::Tensor Da3Backbone::camera_tokens(const std::vector<Camera>& cameras) const {
  if (!camera_encoder_) {
    fail({"known cameras", "a model with a camera encoder", "one without",
          "convert a file that has the tensors model.cam_enc.*, or let the model find the cameras itself"});
  }
  return camera_encoder_->forward(cameras);
}

std::vector<torch::Tensor> Da3Backbone::encode_with_cameras(const torch::Tensor& images, int64_t last_level,
                                                            const std::vector<Camera>& cameras,
                                                            std::vector<AttentionTap>* taps) const {
  require_images(images);
  if (static_cast<int64_t>(cameras.size()) != images.size(0)) {
    fail({"known cameras", "one for each of " + std::to_string(images.size(0)) + " images",
          std::to_string(cameras.size()), "give the cameras of these views"});
  }
  return encode_with_tokens(images, last_level, camera_tokens(cameras), taps);
}

std::vector<torch::Tensor> Da3Backbone::encode_with_tokens(const torch::Tensor& images, int64_t last_level,
                                                           const torch::Tensor& camera_tokens,
                                                           std::vector<AttentionTap>* taps) const {
  require_level(last_level);
  require_images(images);
  const auto grid = options_.grid_of(images.size(0), images.size(2), images.size(3));
  const auto class_tokens = class_token_.expand({grid.views, 1, options_.embed_dim});
  const auto tokens = torch::cat({class_tokens, patch_embed_->forward_image(imagenet_normalise(images))}, 1);
  TokenState state;
  state.current = tokens + position_embedding(grid);
  state.camera_tokens = camera_tokens;
  return run_blocks(state, 0, last_level, grid, taps);
}

std::vector<DecodableLevel> Da3Backbone::propagate(const PropagationStart& start) const {
  require_level(start.level);
  require_propagation_tokens(start);
  std::vector<DecodableLevel> levels = {decodable(start.tokens)};
  const int64_t last_level = options_.levels() - 1;
  if (start.level == last_level) return levels;
  TokenState state;
  state.local = start.tokens.narrow(-1, 0, options_.embed_dim);
  state.current = start.tokens.narrow(-1, options_.embed_dim, options_.embed_dim);
  const int64_t first_block = options_.out_layers[static_cast<size_t>(start.level)] + 1;
  for (const auto& level : run_blocks(state, first_block, last_level, start.grid, nullptr))
    levels.push_back(decodable(level));
  return levels;
}

torch::Tensor Da3Backbone::normalise_for_decoding(const torch::Tensor& patches) const {
  if (patches.dim() != 3 || patches.size(-1) != options_.level_channels()) {
    fail({"backbone", "features (views, tokens, " + std::to_string(options_.level_channels()) + ")",
          "a tensor of shape " + c10::str(patches.sizes()), "give one level of this backbone"});
  }
  const int64_t channels = options_.embed_dim;
  return torch::cat({patches.narrow(-1, 0, channels), norm_->forward(patches.narrow(-1, channels, channels))},
                    -1);
}

void Da3Backbone::initialise(const torch::Generator& generator) {
  initialise_parameters(*this, MatrixInitialisation::kTruncatedNormal, generator);
}

}  // namespace gld
