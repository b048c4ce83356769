#include "models/backbones/vggt_backbone.h"

#include "gld/base/error.h"
#include "models/layers/initialisation.h"

#include <algorithm>
#include <functional>
#include <string>

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr double kBlockNormEpsilon = 1e-5;

VitBlockSizes pair_block(const VggtBackboneOptions& options) {
  VitBlockSizes sizes;
  sizes.embed_dim = options.embed_dim;
  sizes.num_heads = options.num_heads;
  sizes.hidden_dim = static_cast<int64_t>(static_cast<double>(options.embed_dim) * options.mlp_ratio);
  sizes.qk_norm = true;
  sizes.norm_epsilon = kBlockNormEpsilon;
  return sizes;
}

Cost pairs_cost(const VggtBackboneOptions& options, const LatentGrid& grid, int64_t pairs) {
  const auto width = static_cast<double>(options.embed_dim);
  const double hidden = width * options.mlp_ratio;
  const auto views = static_cast<double>(grid.views);
  const auto per_view = static_cast<double>(grid.tokens_per_view() + options.leading_tokens());
  const double rows = views * per_view;
  Cost cost;
  for (int64_t pair = 0; pair < pairs; ++pair) {
    add_linear(cost, rows, width, 8 * width);
    add_linear(cost, rows, width, 4 * hidden);
    cost.attention_flop +=
        views * attention_flop(per_view, per_view, width) + attention_flop(rows, rows, width);
  }
  // The levels and their contiguous patches (4 widths each at most), and a block's x, qkv with the turned copies,
  // attention's output and hidden layer.
  cost.working_bytes = bytes_of_floats(rows * (width * 26 + hidden));
  return cost;
}

}  // namespace

void VggtPatchEmbedOptions::visit(FieldVisitor& visitor) {
  int dinov2 = 0;
  visitor.choice({"type", "family of the transformer that makes patch tokens"}, dinov2, {"dinov2"});
  visitor.integer({"depth", "number of blocks"}, sizes.depth, {1, 1024});
  sizes.visit_positions(visitor);
}

void VggtBackboneOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"patch_size", "side of a patch in pixels"}, patch_size, {1, 1024});
  visitor.integer({"embed_dim", "channels of a token"}, embed_dim, {4, 1 << 16});
  visitor.integer({"depth", "pairs of a block within a view and one over all views"}, depth, {1, 1024});
  visitor.integer({"num_heads", "attention heads"}, num_heads, {1, 1024});
  visitor.real({"mlp_ratio", "width of the feed-forward part over embed_dim"}, mlp_ratio, {0.01, 64});
  visitor.integer({"num_register_tokens", "register tokens of a view, behind its camera token"},
                  num_register_tokens, {1, 1024});
  visitor.integer({"pos_embed_grid", "rows and columns of the stored position table"}, pos_embed_grid,
                  {1, 4096});
  visitor.real({"rope_frequency", "base of the rotary frequencies"}, rope_frequency, {1, 1e9});
  visitor.integers({"out_layers", "pairs after which levels 0, 1, ... are taken, ascending"}, out_layers,
                   {0, 1023});
  visitor.group({"patch_embed", "transformer that makes patch tokens"}, patch_embed);
}

void VggtBackboneOptions::check() const {
  if (embed_dim % (4 * num_heads) != 0) {
    fail({"num_heads", "a head size (embed_dim / num_heads) divisible by 4 for rotary positions",
          std::to_string(embed_dim) + " / " + std::to_string(num_heads), "change num_heads or embed_dim"});
  }
  const bool ascending =
      std::adjacent_find(out_layers.begin(), out_layers.end(), std::greater_equal<>()) == out_layers.end();
  if (out_layers.empty() || !ascending || out_layers.back() >= depth) {
    fail({"out_layers", "ascending numbers of pairs below depth " + std::to_string(depth),
          c10::str(c10::IntArrayRef(out_layers)), "list the pairs after which the levels are taken"});
  }
}

std::unique_ptr<BackboneArchitecture> VggtBackboneOptions::copy() const {
  return std::make_unique<VggtBackboneOptions>(*this);
}

std::shared_ptr<Backbone> VggtBackboneOptions::make(const ParameterPlacement& placement) const {
  return std::make_shared<VggtBackbone>(*this, placement);
}

Dinov2Sizes VggtBackboneOptions::patch_embed_sizes() const {
  Dinov2Sizes sizes = patch_embed.sizes;
  sizes.patch_size = patch_size;
  sizes.embed_dim = embed_dim;
  sizes.num_heads = num_heads;
  sizes.mlp_ratio = mlp_ratio;
  sizes.pos_embed_grid = pos_embed_grid;
  return sizes;
}

Cost VggtBackboneOptions::encoding_cost(const LatentGrid& grid, int64_t last_level) const {
  Cost cost = pairs_cost(*this, grid, out_layers.at(static_cast<size_t>(last_level)) + 1);
  const Cost in_front = patch_embed_sizes().blocks_cost(grid, patch_embed.sizes.depth);
  cost.add_operations_of(in_front);
  cost.weight_bytes += in_front.weight_bytes;
  return cost;
}

Cost VggtBackboneOptions::propagation_cost(const LatentGrid& grid, int64_t level) const {
  return pairs_cost(*this, grid, out_layers.back() - out_layers.at(static_cast<size_t>(level)));
}

VggtBackbone::VggtBackbone(const VggtBackboneOptions& options, const ParameterPlacement& placement)
    : options_((options.check(), options)),
      patch_embed_(register_module("patch_embed", std::make_shared<torch::nn::Module>())),
      patch_layers_(*patch_embed_, options_.patch_embed_sizes(), placement) {
  const auto blocks = [&](const char* name, std::vector<std::shared_ptr<VitBlock>>& list) {
    auto parent = register_module(name, std::make_shared<torch::nn::Module>());
    for (int64_t i = 0; i < options_.depth; ++i) {
      list.push_back(parent->register_module(std::to_string(i),
                                             std::make_shared<VitBlock>(pair_block(options_), placement)));
    }
  };
  blocks("frame_blocks", frame_blocks_);
  blocks("global_blocks", global_blocks_);
  const auto token = [&](const char* name, int64_t count) {
    return register_parameter(name, torch::empty({1, 2, count, options_.embed_dim}, placement.options()));
  };
  camera_token_ = token("camera_token", 1);
  register_token_ = token("register_token", options_.num_register_tokens);
}

torch::Tensor VggtBackbone::of_views(const torch::Tensor& token, int64_t views) const {
  const auto first = token.select(1, 0);
  const auto others = token.select(1, 1).expand({views - 1, token.size(2), token.size(3)});
  return torch::cat({first, others});
}

std::vector<torch::Tensor> VggtBackbone::run_pairs(torch::Tensor tokens, int64_t first_pair,
                                                   int64_t last_level, const LatentGrid& grid,
                                                   std::vector<AttentionTap>* taps) const {
  RotaryGrid positions;
  positions.height = grid.height;
  positions.width = grid.width;
  positions.head_dim = options_.embed_dim / options_.num_heads;
  positions.frequency = options_.rope_frequency;
  positions.leading_tokens = options_.leading_tokens();
  // A view's own positions in both kinds of blocks.
  const auto tables = local_rotary_tables(positions, tokens.options().requires_grad(false));
  std::vector<torch::Tensor> levels;
  const int64_t last_pair = options_.out_layers[static_cast<size_t>(last_level)];
  for (int64_t i = first_pair; i <= last_pair; ++i) {
    const auto pair = static_cast<size_t>(i);
    AttentionTap* wanted = nullptr;
    if (taps != nullptr) {
      for (AttentionTap& tap : *taps) wanted = tap.block == 2 * i + 1 ? &tap : wanted;
    }
    const auto frame = frame_blocks_[pair]->forward(tokens, AttentionScope::kLocal, tables);
    tokens = global_blocks_[pair]->forward(frame, AttentionScope::kGlobal, tables, wanted);
    if (std::find(options_.out_layers.begin(), options_.out_layers.end(), i) != options_.out_layers.end()) {
      levels.push_back(torch::cat({frame, tokens}, -1));
    }
  }
  return levels;
}

std::vector<torch::Tensor> VggtBackbone::encode(const torch::Tensor& images, int64_t last_level,
                                                std::vector<AttentionTap>* taps) const {
  require_level(last_level);
  require_images(images);
  const auto grid = options_.grid_of(images.size(0), images.size(2), images.size(3));
  const auto patches = patch_layers_.forward(images, {options_.patch_embed.sizes.depth - 1})
                           .front()
                           .slice(1, options_.patch_embed.sizes.leading_tokens());
  const auto tokens =
      torch::cat({of_views(camera_token_, grid.views), of_views(register_token_, grid.views), patches}, 1);
  return run_pairs(tokens, 0, last_level, grid, taps);
}

torch::Tensor VggtBackbone::leading_for_propagation(const torch::Tensor& first_source, int64_t level) const {
  const auto levels = encode(torch::cat({first_source, first_source}), level);
  return levels.at(static_cast<size_t>(level)).narrow(1, 0, options_.leading_tokens()).contiguous();
}

std::vector<DecodableLevel> VggtBackbone::propagate(const PropagationStart& start) const {
  require_level(start.level);
  require_propagation_tokens(start);
  std::vector<DecodableLevel> levels = {decodable(start.tokens)};
  const int64_t last_level = options_.levels() - 1;
  if (start.level == last_level) return levels;
  const auto state = start.tokens.narrow(-1, options_.embed_dim, options_.embed_dim);
  const int64_t first_pair = options_.out_layers[static_cast<size_t>(start.level)] + 1;
  for (const auto& level : run_pairs(state, first_pair, last_level, start.grid, nullptr)) {
    levels.push_back(decodable(level));
  }
  return levels;
}

torch::Tensor VggtBackbone::normalise_for_decoding(const torch::Tensor& patches) const { return patches; }

void VggtBackbone::initialise(const torch::Generator& generator) {
  initialise_parameters(*this, MatrixInitialisation::kTruncatedNormal, generator);
  torch::NoGradGuard no_grad;
  for (auto& buffer : buffers()) buffer.zero_();
}

}  // namespace gld
