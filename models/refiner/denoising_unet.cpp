#include "models/refiner/denoising_unet.h"

#include "gld/base/error.h"
#include "models/layers/child_module.h"
#include "models/layers/initialisation.h"
#include "models/refiner/one_step_update.h"
#include "models/refiner/view_grid.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kBlockNormEpsilon = 1e-5;
// The timestep's sines have wave lengths from 2 pi to about this times that.
constexpr double kLongestWave = 10000;
// The timestep's embedding has so many times the channels of the first stage.
constexpr int64_t kTimeWidening = 4;

}  // namespace

ResidualBlockSizes DenoisingUnet::block_sizes(int64_t inputs, int64_t outputs) const {
  return {inputs, outputs, options_.norm_groups, kBlockNormEpsilon,
          kTimeWidening * options_.channels.front()};
}

std::shared_ptr<UnetAttention> DenoisingUnet::make_attention(torch::nn::Module& parent,
                                                             const std::string& name, size_t stage,
                                                             const ParameterPlacement& placement) const {
  const UnetAttentionSizes sizes{options_.channels[stage], options_.heads[stage], options_.norm_groups,
                                 options_.prompt_channels};
  return parent.register_module(name, std::make_shared<UnetAttention>(sizes, placement));
}

DenoisingUnet::DenoisingUnet(const RefinerOptions& options, const ParameterPlacement& placement)
    : options_((options.check(), options)) {
  const auto& channels = options_.channels;
  const int64_t first = channels.front(), time_channels = kTimeWidening * first;
  prompt_ = register_parameter(
      "prompt", torch::empty({options_.prompt_tokens, options_.prompt_channels}, placement.options()));
  const auto time = child_module(*this, "time_embedding");
  const auto of_time = [&](const char* name, int64_t inputs) {
    return time->register_module(
        name, std::make_shared<Linear>(LinearSizes{inputs, time_channels, true, 1, LinearPacking::kNever},
                                       placement));
  };
  time1_ = of_time("linear_1", first);
  time2_ = of_time("linear_2", time_channels);
  const auto convolution = [&](torch::nn::Module& parent, const char* name, const ConvolutionSizes& sizes) {
    return parent.register_module(name, std::make_shared<Convolution>(sizes, placement));
  };
  input_ = convolution(*this, "conv_in", same_size_convolution(options_.latent_channels, first, 3));

  // What the way up takes beside its own, in the order in which it was made.
  std::vector<int64_t> skipped = {first};
  const auto down = child_module(*this, "down_blocks"), up = child_module(*this, "up_blocks");
  int64_t width = first;
  for (size_t i = 0; i < channels.size(); ++i) {
    const auto stage = child_module(*down, std::to_string(i));
    const auto layers = child_module(*stage, "resnets");
    const auto attentions = attends(i) ? child_module(*stage, "attentions") : nullptr;
    Stage made;
    for (int64_t layer = 0; layer < options_.layers_per_block; ++layer) {
      const std::string name = std::to_string(layer);
      made.layers.push_back(layers->register_module(
          name, std::make_shared<ResidualBlock>(block_sizes(width, channels[i]), placement)));
      if (attentions) made.attentions.push_back(make_attention(*attentions, name, i, placement));
      width = channels[i];
      skipped.push_back(width);
    }
    if (i + 1 < channels.size()) {
      auto halving = same_size_convolution(width, width, 3);
      halving.stride = 2;
      made.resize = convolution(*child_module(*child_module(*stage, "downsamplers"), "0"), "conv", halving);
      skipped.push_back(width);
    }
    down_.push_back(std::move(made));
  }
  const auto middle = child_module(*this, "mid_block");
  const auto middle_layers = child_module(*middle, "resnets");
  middle_attention_ =
      make_attention(*child_module(*middle, "attentions"), "0", channels.size() - 1, placement);
  for (const char* name : {"0", "1"}) {
    middle_.push_back(middle_layers->register_module(
        name, std::make_shared<ResidualBlock>(block_sizes(width, width), placement)));
  }
  for (size_t i = channels.size(); i-- > 0;) {
    const auto stage = child_module(*up, std::to_string(channels.size() - 1 - i));
    const auto layers = child_module(*stage, "resnets");
    const auto attentions = attends(i) ? child_module(*stage, "attentions") : nullptr;
    Stage made;
    for (int64_t layer = 0; layer <= options_.layers_per_block; ++layer) {
      const std::string name = std::to_string(layer);
      made.layers.push_back(layers->register_module(
          name,
          std::make_shared<ResidualBlock>(block_sizes(width + skipped.back(), channels[i]), placement)));
      if (attentions) made.attentions.push_back(make_attention(*attentions, name, i, placement));
      width = channels[i];
      skipped.pop_back();
    }
    if (i > 0) {
      made.resize = convolution(*child_module(*child_module(*stage, "upsamplers"), "0"), "conv",
                                same_size_convolution(width, width, 3));
    }
    up_.push_back(std::move(made));
  }
  norm_ = register_module(
      "conv_norm_out",
      std::make_shared<GroupNorm>(GroupNormSizes{width, options_.norm_groups, kBlockNormEpsilon}, placement));
  output_ = convolution(*this, "conv_out", same_size_convolution(width, options_.latent_channels, 3));
}

torch::Tensor DenoisingUnet::time_embedding(int64_t timestep) const {
  const int64_t half = options_.channels.front() / 2;
  const auto rates =
      torch::exp(-std::log(kLongestWave) / static_cast<double>(half) * torch::arange(half, torch::kFloat64));
  const auto angles = static_cast<double>(timestep) * rates;
  const auto waves =
      torch::cat({angles.cos(), angles.sin()}).unsqueeze(0).to(prompt_.device(), prompt_.scalar_type());
  return time2_->forward(torch::silu(time1_->forward(waves)));
}

torch::Tensor DenoisingUnet::of_maps(const torch::Tensor& maps, int64_t timestep,
                                     const JoinedViews& joined) const {
  const auto time = time_embedding(timestep);
  auto x = input_->forward(maps);
  std::vector<torch::Tensor> skipped = {x};
  for (const Stage& stage : down_) {
    for (size_t layer = 0; layer < stage.layers.size(); ++layer) {
      x = stage.layers[layer]->forward(x, time);
      if (!stage.attentions.empty()) x = stage.attentions[layer]->forward(x, prompt_, joined);
      skipped.push_back(x);
    }
    if (!stage.resize) continue;
    x = stage.resize->forward(x);
    skipped.push_back(x);
  }
  x = middle_[0]->forward(x, time);
  x = middle_[1]->forward(middle_attention_->forward(x, prompt_, joined), time);
  for (const Stage& stage : up_) {
    for (size_t layer = 0; layer < stage.layers.size(); ++layer) {
      x = stage.layers[layer]->forward(torch::cat({x, skipped.back()}, 1), time);
      skipped.pop_back();
      if (!stage.attentions.empty()) x = stage.attentions[layer]->forward(x, prompt_, joined);
    }
    // The map is brought to the size of what comes next, which is twice this one or one less.
    if (stage.resize) {
      x = stage.resize->forward(
          torch::upsample_nearest2d(x, {skipped.back().size(2), skipped.back().size(3)}));
    }
  }
  return output_->forward(torch::silu(norm_->forward(x)));
}

torch::Tensor DenoisingUnet::forward(const torch::Tensor& views, int64_t timestep) const {
  if (views.dim() != 5 || views.size(2) != options_.latent_channels) {
    fail({"refiner", fmt::format("(scenes, views, {} channels, height, width)", options_.latent_channels),
          "a tensor of shape " + c10::str(views.sizes()), "give latents of the refiner's own autoencoder"});
  }
  JoinedViews joined;
  joined.attention = options_.attention;
  if (options_.attention == ViewAttention::kGrid)
    return views_of_grid(of_maps(as_grid(views), timestep, joined), view_grid(views.size(1)));
  joined.views = views.size(1);
  return of_maps(views.flatten(0, 1), timestep, joined).view_as(views);
}

void DenoisingUnet::initialise(const torch::Generator& generator) {
  const torch::NoGradGuard no_grad;
  initialise_parameters(*this, MatrixInitialisation::kFanInUniform, generator);
  output_->weight.zero_();
}

torch::Tensor refined_latents(const DenoisingUnet& unet, const torch::Tensor& views) {
  const RefinerOptions& options = unet.options();
  const auto prediction = unet.forward(views, options.timestep);
  return one_step_update(views.select(1, 0), prediction.select(1, 0),
                         one_step_gains(options.timestep, options.form));
}

Cost refiner_cost(const RefinerOptions& options, int64_t views, int64_t height, int64_t width) {
  Cost cost;
  if (!options.exists()) return cost;
  const auto count = static_cast<double>(views);
  double pixels = static_cast<double>(height) * static_cast<double>(width);  // of a view, at this stage
  const auto residual = [&](double inputs, double outputs) {
    add_convolution(cost, count * pixels, inputs, outputs, 3);
    add_convolution(cost, count * pixels, outputs, outputs, 3);
    if (inputs != outputs) add_convolution(cost, count * pixels, inputs, outputs, 1);
  };
  const auto attend = [&](double channels) {
    // Two projections, those of both attentions, and the feed-forward layer.
    add_linear(cost, count * pixels, channels, (2 + 4 + 2 + 12) * channels);
    cost.attention_flop += 4 * scored_pairs(views, pixels, options.attention) * channels;
    cost.attention_flop +=
        attention_flop(count * pixels, static_cast<double>(options.prompt_tokens), channels);
  };
  const auto& channels = options.channels;
  auto now = static_cast<double>(channels.front());
  const auto latent = static_cast<double>(options.latent_channels);
  add_convolution(cost, count * pixels, latent, now, 3);
  std::vector<double> skipped = {now};
  for (size_t i = 0; i < channels.size(); ++i) {
    const auto own = static_cast<double>(channels[i]);
    for (int64_t layer = 0; layer < options.layers_per_block; ++layer) {
      residual(now, own);
      if (static_cast<int64_t>(i) < options.attending_stages) attend(own);
      now = own;
      skipped.push_back(now);
    }
    if (i + 1 == channels.size()) break;
    pixels /= 4;
    add_convolution(cost, count * pixels, now, now, 3);
    skipped.push_back(now);
  }
  residual(now, now);
  attend(now);
  residual(now, now);
  for (size_t i = channels.size(); i-- > 0;) {
    const auto own = static_cast<double>(channels[i]);
    for (int64_t layer = 0; layer <= options.layers_per_block; ++layer) {
      residual(now + skipped.back(), own);
      skipped.pop_back();
      if (static_cast<int64_t>(i) < options.attending_stages) attend(own);
      now = own;
    }
    if (i == 0) break;
    pixels *= 4;
    add_convolution(cost, count * pixels, now, now, 3);
  }
  add_convolution(cost, count * pixels, now, latent, 3);
  // This counts what the way up takes, the widest maps of a block, a feed-forward layer's, and what goes in and comes
  // out.
  const double maps =
      static_cast<double>(channels.front()) * (static_cast<double>(options.layers_per_block + 1) * 2 + 16);
  cost.working_bytes = bytes_of_floats(count * pixels * (maps + 2 * latent));
  return cost;
}

}  // namespace gld
