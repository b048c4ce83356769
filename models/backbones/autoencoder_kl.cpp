#include "models/backbones/autoencoder_kl.h"

#include "gld/attention/attention.h"
#include "gld/base/error.h"
#include "gld/base/sha256.h"
#include "gld/latents/latent_tokens.h"
#include "gld/latents/noise.h"
#include "models/layers/child_module.h"
#include "models/layers/initialisation.h"
#include "models/layers/residual_block.h"

#include <algorithm>
#include <string>

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr double kNormEpsilon = 1e-6;
// The logarithm of a posterior's variance is held between these.
constexpr double kLeastLogVariance = -30, kLargestLogVariance = 20;

}  // namespace

// Attention of one head over the pixels of a map, added to it. A part of AutoencoderKlHalf, which the header names: the
// types of its members may not be in an anonymous namespace.
class KlPixelAttention : public torch::nn::Module {
 public:
  KlPixelAttention(int64_t channels, int64_t groups, const ParameterPlacement& placement) {
    norm_ = register_module(
        "group_norm", std::make_shared<GroupNorm>(GroupNormSizes{channels, groups, kNormEpsilon}, placement));
    const auto linear = [&](torch::nn::Module& parent, const char* name) {
      return parent.register_module(name,
                                    std::make_shared<Linear>(LinearSizes{channels, channels}, placement));
    };
    query_ = linear(*this, "to_q");
    key_ = linear(*this, "to_k");
    value_ = linear(*this, "to_v");
    projection_ = linear(*child_module(*this, "to_out"), "0");
  }
  torch::Tensor forward(const torch::Tensor& x) const {
    const auto tokens = norm_->forward(x).flatten(2).transpose(1, 2).contiguous();
    AttentionInputs inputs;
    inputs.query = query_->forward(tokens).unsqueeze(2);
    inputs.key = key_->forward(tokens).unsqueeze(2);
    inputs.value = value_->forward(tokens).unsqueeze(2);
    const auto attended = projection_->forward(attention(inputs).squeeze(2));
    return x + attended.transpose(1, 2).reshape(x.sizes());
  }

 private:
  std::shared_ptr<GroupNorm> norm_;
  std::shared_ptr<Linear> query_, key_, value_, projection_;
};

enum class KlHalf { kEncoder, kDecoder };

namespace {

// Returns the channels of the stages of a half, as they run.
std::vector<int64_t> stage_channels(const AutoencoderKlOptions& options, KlHalf half) {
  auto channels = options.block_out_channels;
  if (half == KlHalf::kDecoder) std::reverse(channels.begin(), channels.end());
  return channels;
}

// A decoder's stages have a layer more.
int64_t stage_layers(const AutoencoderKlOptions& options, KlHalf half) {
  return options.layers_per_block + (half == KlHalf::kDecoder ? 1 : 0);
}

Cost half_cost(const AutoencoderKlOptions& options, const LatentGrid& grid, KlHalf half) {
  const bool encodes = half == KlHalf::kEncoder;
  const auto channels = stage_channels(options, half);
  const auto latent_pixels =
      static_cast<double>(grid.views * grid.tokens_per_view() * options.latent_patch * options.latent_patch);
  const auto reduction = static_cast<double>(options.reduction());
  double pixels = encodes ? latent_pixels * reduction * reduction : latent_pixels;
  Cost cost;
  const auto residual = [&](double inputs, double outputs) {
    add_convolution(cost, pixels, inputs, outputs, 3);
    add_convolution(cost, pixels, outputs, outputs, 3);
    if (inputs != outputs) add_convolution(cost, pixels, inputs, outputs, 1);
  };
  const auto middle = [&](double width) {
    residual(width, width);
    residual(width, width);
    add_linear(cost, latent_pixels, width, 4 * width);
    const double per_view = latent_pixels / static_cast<double>(grid.views);
    cost.attention_flop += static_cast<double>(grid.views) * attention_flop(per_view, per_view, width);
  };
  const auto latents = static_cast<double>((encodes ? 2 : 1) * options.latent_channels);
  auto width = static_cast<double>(channels.front());
  add_convolution(cost, pixels, encodes ? 3 : latents, width, 3);
  if (!encodes) middle(width);
  for (size_t stage = 0; stage < channels.size(); ++stage) {
    for (int64_t layer = 0; layer < stage_layers(options, half); ++layer) {
      residual(width, static_cast<double>(channels[stage]));
      width = static_cast<double>(channels[stage]);
    }
    if (stage + 1 == channels.size()) break;
    if (!encodes) pixels *= 4;
    if (encodes) pixels /= 4;
    add_convolution(cost, pixels, width, width, 3);
  }
  if (encodes) middle(width);
  add_convolution(cost, pixels, width, encodes ? latents : 3, 3);
  // This counts one view at a time, at full size: a block's input, its normalised copies and its result, and what
  // LibTorch lays out for a convolution; then the images of all views.
  const double full_size = latent_pixels / static_cast<double>(grid.views) * reduction * reduction;
  const auto widest = static_cast<double>(
      std::max(options.block_out_channels.front(),
               options.block_out_channels[std::min<size_t>(1, options.block_out_channels.size() - 1)]));
  cost.working_bytes = bytes_of_floats(full_size * (5 * widest + 9 * static_cast<double>(grid.views)));
  return cost;
}

// Of the picture's 8-bit pixels: the image takes part in the seed of its noise, so that views differ and none depends
// on the others, and what was computed does not, so that every device and precision draws the same.
uint64_t picture_bits(const torch::Tensor& image) {
  const auto pixels =
      (image.detach().to(torch::kCPU, torch::kFloat64) * 255).round().clamp(0, 255).to(torch::kUInt8);
  const auto bytes = pixels.contiguous();
  Sha256 hash;
  hash.update(ByteView{bytes.data_ptr<uint8_t>(), static_cast<size_t>(bytes.numel())});
  return std::stoull(hash.hex_digest().substr(0, 16), nullptr, 16);
}

}  // namespace

// Encoder or decoder, up to the moments and from the latents.
class AutoencoderKlHalf : public torch::nn::Module {
 public:
  AutoencoderKlHalf(const AutoencoderKlOptions& options, KlHalf half, const ParameterPlacement& placement)
      : half_(half) {
    const bool encodes = half == KlHalf::kEncoder;
    const auto channels = stage_channels(options, half);
    const int64_t groups = options.norm_groups;
    const auto convolution = [&](torch::nn::Module& parent, const char* name, ConvolutionSizes sizes) {
      return parent.register_module(name, std::make_shared<Convolution>(sizes, placement));
    };
    input_ = convolution(*this, "conv_in",
                         same_size_convolution(encodes ? 3 : options.latent_channels, channels.front(), 3));
    const auto stages = child_module(*this, encodes ? "down_blocks" : "up_blocks");
    int64_t width = channels.front();
    for (size_t i = 0; i < channels.size(); ++i) {
      const auto stage = child_module(*stages, std::to_string(i));
      const auto layers = child_module(*stage, "resnets");
      Stage made;
      for (int64_t layer = 0; layer < stage_layers(options, half); ++layer) {
        made.layers.push_back(layers->register_module(
            std::to_string(layer),
            std::make_shared<ResidualBlock>(ResidualBlockSizes{width, channels[i], groups, kNormEpsilon, 0},
                                            placement)));
        width = channels[i];
      }
      if (i + 1 < channels.size()) {
        auto sizes = same_size_convolution(width, width, 3);
        if (encodes) {
          sizes.stride = 2;
          sizes.padding = 0;
        }
        const auto resizers = child_module(*stage, encodes ? "downsamplers" : "upsamplers");
        made.resize = convolution(*child_module(*resizers, "0"), "conv", sizes);
      }
      stages_.push_back(std::move(made));
    }
    const int64_t inner = options.block_out_channels.back();
    const auto middle = child_module(*this, "mid_block");
    const auto attentions = child_module(*middle, "attentions"), layers = child_module(*middle, "resnets");
    attention_ =
        attentions->register_module("0", std::make_shared<KlPixelAttention>(inner, groups, placement));
    for (const char* name : {"0", "1"}) {
      middle_.push_back(layers->register_module(
          name, std::make_shared<ResidualBlock>(ResidualBlockSizes{inner, inner, groups, kNormEpsilon, 0},
                                                placement)));
    }
    norm_ = register_module(
        "conv_norm_out", std::make_shared<GroupNorm>(GroupNormSizes{width, groups, kNormEpsilon}, placement));
    output_ = convolution(*this, "conv_out",
                          same_size_convolution(width, encodes ? 2 * options.latent_channels : 3, 3));
  }

  torch::Tensor forward(const torch::Tensor& input) const {
    auto x = input_->forward(input);
    if (half_ == KlHalf::kDecoder) x = middle(x);
    for (const auto& stage : stages_) {
      for (const auto& layer : stage.layers) x = layer->forward(x);
      if (!stage.resize) continue;
      if (half_ == KlHalf::kEncoder) {
        // A row and a column of zeros are added at the far sides only.
        x = stage.resize->forward(torch::constant_pad_nd(x, {0, 1, 0, 1}));
      } else {
        x = stage.resize->forward(torch::upsample_nearest2d(x, {2 * x.size(2), 2 * x.size(3)}));
      }
    }
    if (half_ == KlHalf::kEncoder) x = middle(x);
    return output_->forward(torch::silu(norm_->forward(x)));
  }

 private:
  struct Stage {
    std::vector<std::shared_ptr<ResidualBlock>> layers;
    std::shared_ptr<Convolution> resize;  // null of the last stage
  };
  torch::Tensor middle(const torch::Tensor& x) const {
    return middle_[1]->forward(attention_->forward(middle_[0]->forward(x)));
  }

  KlHalf half_;
  std::shared_ptr<Convolution> input_, output_;
  std::vector<Stage> stages_;
  std::shared_ptr<KlPixelAttention> attention_;
  std::vector<std::shared_ptr<ResidualBlock>> middle_;
  std::shared_ptr<GroupNorm> norm_;
};

void AutoencoderKlOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"latent_channels", "channels of a latent pixel"}, latent_channels, {1, 1024});
  visitor.integers({"block_out_channels", "channels of the stages; each but the last halves the sides"},
                   block_out_channels, {1, 1 << 14});
  visitor.integer({"layers_per_block", "residual blocks of an encoder's stage"}, layers_per_block, {1, 64});
  visitor.integer({"norm_groups", "groups of the group norms"}, norm_groups, {1, 1024});
  visitor.real({"scaling_factor", "of latents: 0.18215 for Stable Diffusion, 0.13025 for SDXL"},
               scaling_factor, {1e-6, 1e6});
  visitor.real({"shift_factor", "subtracted from latents before they are scaled"}, shift_factor, {-1e6, 1e6});
  visit_choice(visitor, {"posterior", "what latents are: the posterior's mean, or a sample of it"}, posterior,
               {"mean", "sample"});
  visitor.integer({"posterior_seed", "seed of the posterior's samples"}, posterior_seed, {0, INT64_MAX});
  visitor.integer({"latent_patch", "latent pixels of a token along each side: the DiT's patch size"},
                  latent_patch, {1, 64});
}

void AutoencoderKlOptions::check() const {
  for (const int64_t channels : block_out_channels) {
    if (channels % norm_groups == 0) continue;
    fail({"block_out_channels", "multiples of norm_groups " + std::to_string(norm_groups),
          std::to_string(channels), "change block_out_channels or norm_groups"});
  }
  if (block_out_channels.empty() || block_out_channels.size() > 8) {
    fail({"block_out_channels", "one to eight stages", std::to_string(block_out_channels.size()),
          "write for example [128, 256, 512, 512]"});
  }
}

std::unique_ptr<BackboneArchitecture> AutoencoderKlOptions::copy() const {
  return std::make_unique<AutoencoderKlOptions>(*this);
}

std::shared_ptr<Backbone> AutoencoderKlOptions::make(const ParameterPlacement& placement) const {
  return std::make_shared<AutoencoderKl>(*this, placement);
}

Cost AutoencoderKlOptions::encoding_cost(const LatentGrid& grid, int64_t /*last_level*/) const {
  return half_cost(*this, grid, KlHalf::kEncoder);
}

Cost AutoencoderKlOptions::decoding_cost(const LatentGrid& grid) const {
  return half_cost(*this, grid, KlHalf::kDecoder);
}

AutoencoderKl::AutoencoderKl(const AutoencoderKlOptions& options, const ParameterPlacement& placement)
    : options_((options.check(), options)) {
  encoder_ =
      register_module("encoder", std::make_shared<AutoencoderKlHalf>(options_, KlHalf::kEncoder, placement));
  decoder_ =
      register_module("decoder", std::make_shared<AutoencoderKlHalf>(options_, KlHalf::kDecoder, placement));
  const int64_t channels = options_.latent_channels;
  quant_ = register_module(
      "quant_conv",
      std::make_shared<Convolution>(same_size_convolution(2 * channels, 2 * channels, 1), placement));
  post_quant_ =
      register_module("post_quant_conv",
                      std::make_shared<Convolution>(same_size_convolution(channels, channels, 1), placement));
}

torch::Tensor AutoencoderKl::moments(const torch::Tensor& images) const {
  const auto all = quant_->forward(encoder_->forward(images * 2 - 1));
  const int64_t channels = options_.latent_channels;
  return torch::cat({all.narrow(1, 0, channels),
                     all.narrow(1, channels, channels).clamp(kLeastLogVariance, kLargestLogVariance)},
                    1);
}

torch::Tensor AutoencoderKl::images_of(const torch::Tensor& latents) const {
  return decoder_->forward(post_quant_->forward(latents)) / 2 + 0.5;
}

std::vector<torch::Tensor> AutoencoderKl::encode(const torch::Tensor& images, int64_t last_level,
                                                 std::vector<AttentionTap>* /*taps*/) const {
  require_level(last_level);
  require_images(images);
  options_.grid_of(images.size(0), images.size(2), images.size(3));
  std::vector<torch::Tensor> views;
  for (int64_t view = 0; view < images.size(0); ++view) {
    const auto parts = moments(images.narrow(0, view, 1)).chunk(2, 1);
    auto latent = parts[0];
    if (options_.posterior == Posterior::kSample) {
      const uint64_t seed = static_cast<uint64_t>(options_.posterior_seed) ^ picture_bits(images[view]);
      const auto noise = views_noise(seed, "posterior", 1, latent.sizes().slice(1).vec());
      latent = latent + torch::exp(parts[1] / 2) * noise.to(latent.device(), latent.scalar_type());
    }
    views.push_back(
        tokens_of_latents((latent - options_.shift_factor) * options_.scaling_factor, options_.latent_patch));
  }
  return {torch::cat(views)};
}

torch::Tensor AutoencoderKl::decoded_view(const torch::Tensor& latents) const {
  return images_of(latents / options_.scaling_factor + options_.shift_factor);
}

Autoencoding AutoencoderKl::autoencode(const torch::Tensor& images, const torch::Generator& generator) const {
  const auto parts = moments(images).chunk(2, 1);
  const auto noise = torch::randn(parts[0].sizes(), generator, torch::kFloat32)
                         .to(parts[0].device(), parts[0].scalar_type());
  Autoencoding result;
  result.images = images_of(parts[0] + torch::exp(parts[1] / 2) * noise);
  result.divergence = (parts[0].square() + parts[1].exp() - 1 - parts[1]).mean() / 2;
  return result;
}

void AutoencoderKl::initialise(const torch::Generator& generator) {
  initialise_parameters(*this, MatrixInitialisation::kFanInUniform, generator);
}

}  // namespace gld
