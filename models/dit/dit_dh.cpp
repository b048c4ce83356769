#include "models/dit/dit_dh.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "models/layers/position_embedding.h"

#include <algorithm>
#include <functional>
#include <string>
#include <utility>

#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

// How many blocks share one kept input where activations are computed again: 2 keep three tensors for two blocks in the
// place of four, for one more feed-forward part in two blocks.
constexpr size_t kBlocksAKeptInput = 2;

// Returns the tokens of every pass, one after the other, with what the pass's cameras add to them.
torch::Tensor pass_tokens(const torch::Tensor& tokens, const std::vector<DitBranchCameras>& cameras,
                          torch::Tensor DitBranchCameras::*embedding_of_part) {
  const auto passes = static_cast<int64_t>(cameras.size());
  const int64_t views = cameras.front().decoder_prope.grid.views;
  const bool shared = tokens.size(0) == views;
  std::vector<torch::Tensor> parts;
  for (int64_t pass = 0; pass < passes; ++pass) {
    const auto& embedding = cameras[static_cast<size_t>(pass)].*embedding_of_part;
    const auto own = shared ? tokens : tokens.narrow(0, pass * views, views);
    parts.push_back(embedding.defined() ? own + embedding : own);
  }
  return passes == 1 ? parts.front() : torch::cat(parts);
}

bool at_one_time(const DitPasses& passes) {
  return std::all_of(passes.begin(), passes.end(),
                     [&](const DitPass& pass) { return pass.time == passes.front().time; });
}

// Makes of the rows of the passes' times, each (1 or views, width), one row that all tokens share, or (passes * views,
// width).
torch::Tensor pass_rows(const DitPasses& passes,
                        const std::function<const torch::Tensor&(const DitTimeRow&)>& rows_of) {
  const auto& first = rows_of(*passes.front().time);
  if (passes.size() == 1 || (at_one_time(passes) && first.size(0) == 1)) return first;
  std::vector<torch::Tensor> parts;
  for (const DitPass& pass : passes) {
    const auto& rows = rows_of(*pass.time);
    parts.push_back(rows.expand({pass.scene->grid.views, rows.size(1)}));
  }
  return torch::cat(parts);
}

bool same_grid(const LatentGrid& a, const LatentGrid& b) {
  return a.views == b.views && a.height == b.height && a.width == b.width;
}

void check_passes(const DitPasses& passes) {
  if (passes.empty()) fail({"diffusion model", "at least one scene to evaluate", "none", "give scenes"});
  const LatentGrid& first = passes.front().scene->grid;
  for (const DitPass& pass : passes) {
    const LatentGrid& grid = pass.scene->grid;
    if (same_grid(grid, first)) continue;
    fail({"scenes of one evaluation",
          fmt::format("{} views of {} x {} tokens in each", first.views, first.width, first.height),
          fmt::format("one with {} views of {} x {}", grid.views, grid.width, grid.height),
          "evaluate scenes of one size together"});
  }
}

// lambda(t) of DitDh's comment, and lambda(t) / t, which vanishes with t too.
struct GuessWeights {
  double share = 0;
  double share_over_time = 0;
};

GuessWeights weights_of_guess(double time, double error) {
  const double of_both = time * time + error * (1 - time) * (1 - time);
  return {time * time / of_both, time / of_both};
}

}  // namespace

DitDh::DitDh(const DitOptions& options, const ParameterPlacement& placement) : options_(options) {
  check_options(options_, "diffusion model");
  const int64_t channels = options_.in_channels;
  const auto embedder_sizes = [&](int64_t width) {
    return DitEmbedderSizes{channels, width, options_.split_embedders, options_.num_special_tokens};
  };
  decoder_embedder_ =
      std::make_unique<DitEmbedder>(*this, "x", embedder_sizes(options_.decoder_width()), placement);
  encoder_embedder_ =
      std::make_unique<DitEmbedder>(*this, "s", embedder_sizes(options_.encoder_width()), placement);
  if (options_.num_special_tokens > 0) {
    special_projection_ = register_module(
        "special_output_proj",
        std::make_shared<Linear>(
            LinearSizes{options_.decoder_width(), channels, true, 1, LinearPacking::kNever}, placement));
  }
  if (options_.encoder_width() != options_.decoder_width()) {
    condition_projection_ = register_module(
        "s_projector",
        std::make_shared<Linear>(LinearSizes{options_.encoder_width(), options_.decoder_width()}, placement));
  }
  time_embedding_ =
      register_module("t_embedder", std::make_shared<TimeEmbedding>(options_.encoder_width(), placement));
  constexpr int64_t kCameraChannels = 7;
  camera_embedder_ = register_module(
      "camera_embedder",
      std::make_shared<PatchEmbed>(
          PatchEmbedSizes{kCameraChannels, options_.camera_width(), options_.camera_patch_size}, placement));
  if (options_.warped_sources > 0) {
    warp_embedder_ = register_module(
        "warp_embedder",
        std::make_shared<PatchEmbed>(
            PatchEmbedSizes{options_.warped_sources, options_.encoder_width(), options_.camera_patch_size},
            placement));
  }
  if (options_.carried_error > 0) {
    guess_gate_ = register_module(
        "carried_gate",
        std::make_shared<Linear>(LinearSizes{options_.warped_sources, 1, true, 1, LinearPacking::kNever},
                                 placement));
  }
  final_layer_ = register_module(
      "final_layer",
      std::make_shared<DitFinalLayer>(DitFinalLayerSizes{options_.decoder_width(), channels}, placement));

  auto blocks = register_module("blocks", std::make_shared<torch::nn::Module>());
  for (int64_t i = 0; i < options_.encoder_blocks() + options_.decoder_blocks(); ++i) {
    const size_t part = i < options_.encoder_blocks() ? 0 : 1;
    DitBlockSizes sizes;
    sizes.channels = options_.hidden_size[part];
    sizes.num_heads = options_.num_heads[part];
    sizes.swiglu_width = options_.swiglu_width(sizes.channels);
    sizes.qk_norm = options_.qk_norm;
    auto block = blocks->register_module(std::to_string(i), std::make_shared<DitBlock>(sizes, placement));
    (part == 0 ? encoder_blocks_ : decoder_blocks_).push_back(block);
  }
}

std::vector<DitTimeRow> DitDh::time_rows(const std::vector<double>& times, int64_t rows) const {
  std::vector<double> repeated;
  for (const double time : times) repeated.insert(repeated.end(), static_cast<size_t>(rows), time);
  const auto embedding = time_embedding_->forward(repeated);
  // The published model applies SiLU to the time embedding and again at the head of each block's AdaLN.
  const auto activation = torch::silu(torch::silu(embedding));
  std::vector<DitTimeRow> result(times.size());
  for (size_t i = 0; i < times.size(); ++i) {
    result[i].time = times[i];
    result[i].embedding = embedding.narrow(0, static_cast<int64_t>(i) * rows, rows);
  }
  for (const auto& block : encoder_blocks_) {
    const auto modulation = block->modulation_rows(activation);
    for (size_t i = 0; i < times.size(); ++i) {
      result[i].encoder_modulation.push_back(modulation.narrow(0, static_cast<int64_t>(i) * rows, rows));
    }
  }
  return result;
}

torch::Tensor DitDh::source_part(const DitEmbedder& embedder, const DitScene& scene) const {
  const int64_t special = options_.num_special_tokens, patches = scene.grid.tokens_per_view();
  const auto& source = scene.source_features;
  auto tokens = embedder.source_patches(source.narrow(1, special, patches), scene.grid.views);
  if (special == 0) return tokens;
  return torch::cat({embedder.source_special(source.narrow(1, 0, special), scene.grid.views), tokens}, 1);
}

torch::Tensor DitDh::latent_part(const DitEmbedder& embedder, const DitScene& scene,
                                 const torch::Tensor& noisy) const {
  const int64_t special = options_.num_special_tokens, patches = scene.grid.tokens_per_view();
  auto tokens = embedder.latent_patches(noisy.narrow(1, special, patches), scene.num_sources());
  if (special == 0) return tokens;
  return torch::cat({embedder.latent_special(noisy.narrow(1, 0, special)), tokens}, 1);
}

torch::Tensor DitDh::joint_tokens(const DitEmbedder& embedder, const DitScene& scene,
                                  const torch::Tensor& patches, const torch::Tensor& noisy) const {
  const int64_t special = options_.num_special_tokens;
  const auto& source = scene.source_features;
  auto tokens = embedder.patches(source.narrow(1, special, scene.grid.tokens_per_view()), patches);
  if (special == 0) return tokens;
  return torch::cat({embedder.special(source.narrow(1, 0, special), noisy.narrow(1, 0, special)), tokens}, 1);
}

torch::Tensor DitDh::with_positions(const torch::Tensor& tokens, const DitScene& scene) const {
  if (options_.position_embedding == PositionEmbedding::kNone) return tokens;
  const auto positions = sincos_positions(scene.grid, tokens.size(2), tokens.options());
  const auto none = torch::zeros({options_.num_special_tokens, tokens.size(2)}, tokens.options());
  return tokens + torch::cat({none, positions}, 0);
}

torch::Tensor DitDh::encoder_tokens(const DitScene& scene, const torch::Tensor& noisy) const {
  const auto& embedder = *encoder_embedder_;
  const int64_t special = options_.num_special_tokens;
  if (!scene.encoder_source.defined()) {
    const auto patches = scene.deeper_patches.defined()
                             ? scene.deeper_patches
                             : noisy.narrow(1, special, scene.grid.tokens_per_view());
    return with_positions(joint_tokens(embedder, scene, patches, noisy), scene);
  }
  if (!scene.deeper_patches.defined()) return scene.encoder_source + latent_part(embedder, scene, noisy);
  if (special == 0) return scene.encoder_source;
  // In a cascade only the special tokens carry the noisy latent into the condition encoder.
  return torch::cat(
      {scene.encoder_source.narrow(1, 0, special) + embedder.latent_special(noisy.narrow(1, 0, special)),
       scene.encoder_source.narrow(1, special, scene.grid.tokens_per_view())},
      1);
}

torch::Tensor DitDh::decoder_tokens(const DitScene& scene, const torch::Tensor& noisy) const {
  if (scene.decoder_source.defined()) {
    return scene.decoder_source + latent_part(*decoder_embedder_, scene, noisy);
  }
  const auto patches = noisy.narrow(1, options_.num_special_tokens, scene.grid.tokens_per_view());
  return with_positions(joint_tokens(*decoder_embedder_, scene, patches, noisy), scene);
}

DitNoisyTokens DitDh::embed_noisy(const DitScene& scene, const torch::Tensor& noisy) const {
  check_latent(scene, noisy, "noisy latent", scene.grid.views);
  return {encoder_tokens(scene, noisy), decoder_tokens(scene, noisy)};
}

DitNoisyTokens DitDh::embed_noisy(const DitPasses& passes, const torch::Tensor& noisy) const {
  check_passes(passes);
  const DitScene& first = *passes.front().scene;
  if (passes.size() == 1) return embed_noisy(first, noisy);
  const int64_t views = first.grid.views;
  check_latent(first, noisy, "noisy latents", static_cast<int64_t>(passes.size()) * views);
  std::vector<torch::Tensor> encoder, decoder;
  for (size_t i = 0; i < passes.size(); ++i) {
    const auto own = embed_noisy(*passes[i].scene, noisy.narrow(0, static_cast<int64_t>(i) * views, views));
    encoder.push_back(own.encoder);
    decoder.push_back(own.decoder);
  }
  return {torch::cat(encoder), torch::cat(decoder)};
}

torch::Tensor DitDh::by_storage(const PartFunction& part, const torch::Tensor& x,
                                const torch::Tensor& conditioning) const {
  return activation_storage_ == ActivationStorage::kKeep ? part(x, conditioning)
                                                         : checkpointed_by_views(part, x, conditioning);
}

torch::Tensor DitDh::run_blocks(const std::vector<std::shared_ptr<DitBlock>>& blocks, torch::Tensor x,
                                const DitPasses& passes, const std::vector<DitBranchCameras>& cameras,
                                const std::vector<Modulation>& modulations) const {
  const bool in_decoder = &blocks == &decoder_blocks_;
  const size_t before = in_decoder ? encoder_blocks_.size() : 0;
  const auto tap_of = [&](const DitPass& pass, size_t block) -> AttentionTap* {
    if (pass.scene->taps == nullptr) return nullptr;
    for (AttentionTap& tap : *pass.scene->taps) {
      if (tap.block == static_cast<int64_t>(before + block)) return &tap;
    }
    return nullptr;
  };
  std::vector<DitPassAttention> attention;
  for (size_t i = 0; i < passes.size(); ++i) {
    attention.push_back({in_decoder ? &cameras[i].decoder_prope : &cameras[i].encoder_prope, nullptr});
  }
  if (activation_storage_ == ActivationStorage::kKeep || !torch::GradMode::is_enabled()) {
    for (size_t i = 0; i < blocks.size(); ++i) {
      for (size_t pass = 0; pass < passes.size(); ++pass) attention[pass].tap = tap_of(passes[pass], i);
      x = blocks[i]->forward(x, {modulations[i], attention});
    }
    return x;
  }
  // The tables are copied (they only hold tensors), because the caller's are gone when gradients are computed.
  const auto tables = std::make_shared<std::vector<PropeTables>>();
  for (const DitPassAttention& pass : attention) tables->push_back(*pass.prope);
  for (size_t i = 0; i < attention.size(); ++i) attention[i].prope = &(*tables)[i];
  std::vector<AttentionBlock> chain;
  for (size_t i = 0; i < blocks.size(); ++i) {
    const bool rows = modulations[i].rows.defined();
    const auto context_of = [rows, tables, attention](const torch::Tensor& conditioning) {
      DitBlockContext own;
      (rows ? own.modulation.rows : own.modulation.activation) = conditioning;
      own.passes = attention;
      return own;
    };
    const DitBlock& block = *blocks[i];
    AttentionBlock parts;
    parts.head_dim = block.head_dim();
    parts.inputs = [&block, context_of](const torch::Tensor& tokens, const torch::Tensor& conditioning) {
      return block.attention_inputs(tokens, context_of(conditioning));
    };
    parts.finish = [&block, context_of](const torch::Tensor& tokens, const torch::Tensor& attended,
                                        const torch::Tensor& conditioning) {
      return block.finish(tokens, attended, context_of(conditioning));
    };
    parts.conditioning = rows ? modulations[i].rows : modulations[i].activation;
    chain.push_back(std::move(parts));
    if (chain.size() == kBlocksAKeptInput || i + 1 == blocks.size()) {
      x = checkpointed(chain, x);
      chain.clear();
    }
  }
  return x;
}

torch::Tensor DitDh::condition_encoder(const DitPasses& passes, const DitNoisyTokens& tokens) const {
  check_passes(passes);
  const auto cameras = evaluation_cameras(passes);
  const auto x = pass_tokens(tokens.encoder, cameras, &DitBranchCameras::encoder_embedding);
  std::vector<Modulation> modulations;
  for (size_t i = 0; i < encoder_blocks_.size(); ++i) {
    const auto rows_of = [i](const DitTimeRow& time) -> const torch::Tensor& {
      return time.encoder_modulation[i];
    };
    modulations.push_back({pass_rows(passes, rows_of), {}});
  }
  return run_blocks(encoder_blocks_, x, passes, cameras, modulations);
}

torch::Tensor DitDh::velocity_features(const DitPasses& passes, const DitNoisyTokens& tokens,
                                       const torch::Tensor& condition) const {
  check_passes(passes);
  const auto cameras = evaluation_cameras(passes);
  const auto condition_activation = [this](const torch::Tensor& tokens, const torch::Tensor& time_rows) {
    auto s = torch::silu(tokens + time_rows);
    if (condition_projection_) s = condition_projection_->forward(s);
    return torch::silu(s);
  };
  const auto rows_of = [](const DitTimeRow& time) -> const torch::Tensor& { return time.embedding; };
  Modulation modulation;
  modulation.activation =
      by_storage(condition_activation, condition, pass_rows(passes, rows_of).unsqueeze(1));
  auto x = pass_tokens(tokens.decoder, cameras, &DitBranchCameras::decoder_embedding);
  const std::vector<Modulation> modulations(decoder_blocks_.size(), modulation);
  x = run_blocks(decoder_blocks_, x, passes, cameras, modulations);
  return with_first_guess(passes, by_storage(
                                      [this](const torch::Tensor& tokens, const torch::Tensor& activation) {
                                        return final_layer_->features(tokens, {{}, activation});
                                      },
                                      x, modulation.activation));
}

torch::Tensor DitDh::with_estimate(const DitPasses& passes, const torch::Tensor& features) const {
  const int64_t views = passes.front().scene->grid.views, tokens = features.size(1);
  const auto plain = features.options().requires_grad(false);
  std::vector<torch::Tensor> own_shares, guesses, noisy_shares;
  for (const DitPass& pass : passes) {
    const double time = pass.time->time, rest = 1 - time;
    const bool guessed = pass.branch == DitBranch::kConditional && pass.scene->guess_trust.defined();
    const auto precision =
        guessed ? pass.scene->guess_trust / options_.carried_error : torch::zeros({views, tokens, 1}, plain);
    const auto all = time * time * (1 + precision) + rest * rest;
    // Of (x_t - x) / t, which has no t left to divide by.
    own_shares.push_back(-1 / all.sqrt());
    guesses.push_back(guessed ? -time * precision / all * pass.scene->guess_features
                              : torch::zeros({views, tokens, options_.in_channels}, plain));
    noisy_shares.push_back((time * (1 + precision) - rest) / all);
  }
  const auto own = torch::cat(own_shares);
  return torch::cat({features * own, own, torch::cat(guesses), torch::cat(noisy_shares)}, 2);
}

torch::Tensor DitDh::with_first_guess(const DitPasses& passes, const torch::Tensor& features) const {
  if (!guess_gate_) return features;
  if (options_.carried_guess == CarriedGuess::kCorrected) return with_estimate(passes, features);
  const int64_t views = passes.front().scene->grid.views, tokens = features.size(1);
  const auto plain = features.options().requires_grad(false);
  std::vector<torch::Tensor> own_shares, guesses;
  for (const DitPass& pass : passes) {
    if (pass.branch == DitBranch::kUnconditional || !pass.scene->guess_trust.defined()) {
      own_shares.push_back(torch::ones({views, tokens, 1}, plain));
      guesses.push_back(torch::zeros({views, tokens, options_.in_channels}, plain));
      continue;
    }
    const auto weights = weights_of_guess(pass.time->time, options_.carried_error);
    const bool of_data = options_.prediction == FlowPrediction::kData;
    own_shares.push_back(1 - pass.scene->guess_trust * weights.share);
    guesses.push_back(pass.scene->guess_trust * (of_data ? weights.share : weights.share_over_time) *
                      pass.scene->guess_features);
  }
  const auto own = torch::cat(own_shares);
  return torch::cat({features * own, own, torch::cat(guesses)}, 2);
}

torch::Tensor DitDh::output_of(const torch::Tensor& features) const {
  auto output = final_layer_->project(features);
  const int64_t special = options_.num_special_tokens;
  if (special == 0) return output;
  return torch::cat({special_projection_->forward(output.narrow(1, 0, special)),
                     output.narrow(1, special, output.size(1) - special)},
                    1);
}

torch::Tensor DitDh::velocity_from_features(const torch::Tensor& features, const torch::Tensor& noisy,
                                            double time) const {
  const bool of_data = options_.prediction == FlowPrediction::kData;
  torch::Tensor output;
  if (!guess_gate_) {
    output = output_of(features);
  } else {
    const int64_t width = options_.decoder_width();
    const auto own = features.narrow(2, width, 1),
               guess = features.narrow(2, width + 1, options_.in_channels);
    // The layer adds its whole bias; only the network's share of it counts (1 for special tokens).
    output = output_of(features.narrow(2, 0, width).contiguous()) + (own - 1) * final_layer_->bias();
    constexpr double kSmallestTime = 1e-12;  // where the share of the guess is 0
    if (options_.carried_guess == CarriedGuess::kCorrected)
      return output + guess + features.narrow(2, width + 1 + options_.in_channels, 1) * noisy;
    output = of_data ? output + guess : output + (1 - own) / std::max(time, kSmallestTime) * noisy - guess;
  }
  if (!of_data) return output;
  // x_t = (1 - t) data + t noise, so that v = noise - data = (x_t - data) / t.
  return (noisy - output) * std::min(1.0 / time, options_.largest_inverse_time);
}

torch::Tensor DitDh::velocity(const DitPasses& passes, const torch::Tensor& noisy) const {
  const auto tokens = embed_noisy(passes, noisy);
  const auto features = velocity_features(passes, tokens, condition_encoder(passes, tokens));
  if (at_one_time(passes)) return velocity_from_features(features, noisy, passes.front().time->time);
  const int64_t views = passes.front().scene->grid.views;
  std::vector<torch::Tensor> velocities;
  for (size_t i = 0; i < passes.size(); ++i) {
    const int64_t first = static_cast<int64_t>(i) * views;
    velocities.push_back(velocity_from_features(features.narrow(0, first, views),
                                                noisy.narrow(0, first, views), passes[i].time->time));
  }
  return torch::cat(velocities);
}

}  // namespace gld
