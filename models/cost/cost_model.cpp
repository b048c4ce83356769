#include "models/cost/cost_model.h"

#include "models/layers/adaptive_norm.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

int64_t tokens_of(const DitOptions& options, const LatentGrid& grid) {
  return grid.views * (grid.tokens_per_view() + options.num_special_tokens);
}

struct StackShape {
  int64_t width = 0;
  int64_t blocks = 0;
  int64_t modulation_rows = 0;  // rows that AdaLN is computed for: views, or tokens in the velocity decoder
};

Cost dit_stack_cost(const DitOptions& options, int64_t tokens, const StackShape& stack) {
  const auto width = static_cast<double>(stack.width);
  const auto hidden = static_cast<double>(options.swiglu_width(stack.width));
  const auto rows = static_cast<double>(tokens);
  const auto blocks = static_cast<double>(stack.blocks);
  Cost cost;
  cost.linear_flop = blocks * (product_flop(rows, width, 4 * width) + product_flop(rows, width, 3 * hidden) +
                               product_flop(static_cast<double>(stack.modulation_rows), width, 6 * width));
  cost.attention_flop = blocks * attention_flop(rows, rows, width);
  const auto parameters = blocks * (4 * width * width + 3 * width * hidden + 6 * width * width);
  cost.weight_bytes = static_cast<int64_t>(parameters) * kFloatBytes;
  return cost;
}

// Returns the most of a block, in floats: x, qkv and the attention's output; or x, that output, the result, and of a
// group of tokens (by_view_groups) the modulation and what the feed-forward part makes.
double block_floats(const DitOptions& options, int64_t width, const LatentGrid& grid) {
  const int64_t per_view = grid.tokens_per_view() + options.num_special_tokens;
  const auto tokens = static_cast<double>(grid.views * per_view);
  const auto group = static_cast<double>(views_per_group(grid.views, per_view) * per_view);
  const auto channels = static_cast<double>(width), hidden = static_cast<double>(options.swiglu_width(width));
  return std::max(5 * tokens * channels, 3 * tokens * channels + group * (8 * channels + 3 * hidden));
}

}  // namespace

Cost condition_encoder_cost(const DitOptions& options, const LatentGrid& grid) {
  StackShape stack;
  stack.width = options.encoder_width();
  stack.blocks = options.encoder_blocks();
  stack.modulation_rows = grid.views;
  return dit_stack_cost(options, tokens_of(options, grid), stack);
}

Cost velocity_decoder_cost(const DitOptions& options, const LatentGrid& grid) {
  const int64_t tokens = tokens_of(options, grid);
  StackShape stack;
  stack.width = options.decoder_width();
  stack.blocks = options.decoder_blocks();
  stack.modulation_rows = tokens;
  Cost cost = dit_stack_cost(options, tokens, stack);
  const auto rows = static_cast<double>(tokens);
  const auto width = static_cast<double>(stack.width), channels = static_cast<double>(options.in_channels);
  add_linear(cost, rows, static_cast<double>(options.encoder_width()), width);
  add_linear(cost, rows, channels, width);
  add_linear(cost, rows, width, 2 * width);
  add_linear(cost, rows, width, channels);
  return cost;
}

Cost dit_cost(const DitOptions& options, const LatentGrid& grid) {
  const Cost encoder = condition_encoder_cost(options, grid);
  Cost cost = velocity_decoder_cost(options, grid);
  cost.linear_flop += encoder.linear_flop;
  cost.attention_flop += encoder.attention_flop;
  cost.weight_bytes += encoder.weight_bytes;
  // This counts what a scene keeps (source halves of both embeddings, camera embedding), the embedded latent, and then
  // a block of the condition encoder, or its output, its activation and a block of the velocity decoder.
  const auto tokens = static_cast<double>(tokens_of(options, grid));
  const auto encoder_width = static_cast<double>(options.encoder_width());
  const auto decoder_width = static_cast<double>(options.decoder_width());
  cost.working_bytes = bytes_of_floats(tokens * (3 * encoder_width + 2 * decoder_width) +
                                       std::max(block_floats(options, options.encoder_width(), grid),
                                                tokens * (encoder_width + decoder_width) +
                                                    block_floats(options, options.decoder_width(), grid)));
  return cost;
}

Cost rgb_decoder_cost(const RgbDecoderOptions& options, const LatentGrid& grid) {
  const auto width = static_cast<double>(options.hidden_size);
  const auto hidden = static_cast<double>(options.intermediate_size);
  const auto views = static_cast<double>(grid.views);
  const auto per_view = static_cast<double>(grid.tokens_per_view() + 1);
  const double rows = views * per_view;
  Cost cost;
  for (int64_t layer = 0; layer < options.num_layers; ++layer) {
    add_linear(cost, rows, width, 4 * width);
    add_linear(cost, rows, width, 2 * hidden);
    cost.attention_flop += views * attention_flop(per_view, per_view, width);
  }
  add_linear(cost, rows, static_cast<double>(options.in_channels), width);
  add_linear(cost, rows, width, static_cast<double>(options.patch_values()));
  // The levels side by side, a block of a chunk of views, and the pixels of all: logits in parts and together, images
  // before and after they are denormalised.
  const double chunk_rows =
      per_view *
      std::min(views, std::max(1.0, std::floor(static_cast<double>(RgbDecoder::kTokensPerChunk) / per_view)));
  cost.working_bytes =
      bytes_of_floats(rows * (static_cast<double>(options.in_channels + 3 * options.patch_values())) +
                      chunk_rows * (width * 6 + hidden));
  if (options.refinement_channels > 0) {
    const auto channels = static_cast<double>(options.refinement_channels);
    const double pixels_of_view =
        (per_view - 1) * static_cast<double>(options.patch_size * options.patch_size);
    add_convolution(cost, views * pixels_of_view, 3, channels, 3);
    for (int64_t layer = 2; layer < options.refinement_layers; ++layer) {
      add_convolution(cost, views * pixels_of_view, channels, channels, 3);
    }
    add_convolution(cost, views * pixels_of_view, channels, 3, 3);
    // This counts the refined pixels of all views, and of one view two maps and what its convolution rearranges.
    cost.working_bytes += bytes_of_floats(3 * views * pixels_of_view + 4 * channels * pixels_of_view);
  }
  return cost;
}

}  // namespace gld
