#include "models/backbones/tiny_autoencoder.h"

#include "gld/base/error.h"
#include "gld/latents/latent_tokens.h"
#include "models/layers/initialisation.h"

#include <string>

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr int64_t kNormGroups = 4;
constexpr int64_t kNormWidening = 4;  // of the middle norm's maps
constexpr int64_t kHalvings = 3;
constexpr int64_t kBlocksAStage = 3;
constexpr int64_t kConvolutionsABlock = 3;

ConvolutionSizes tiny_sizes(int64_t inputs, int64_t outputs, int64_t kernel, bool bias) {
  ConvolutionSizes sizes = same_size_convolution(inputs, outputs, kernel);
  sizes.bias = bias;
  return sizes;
}

// Computes relu(x + three convolutions of x), where x may first be normalised over the map, widened, and added to
// itself.
class TinyBlock : public torch::nn::Module {
 public:
  TinyBlock(int64_t width, bool middle_norm, const ParameterPlacement& placement) {
    auto layers = register_module("conv", std::make_shared<torch::nn::Module>());
    for (int64_t i = 0; i < kConvolutionsABlock; ++i) {
      convolutions_.push_back(layers->register_module(
          std::to_string(2 * i),
          std::make_shared<Convolution>(tiny_sizes(width, width, 3, true), placement)));
    }
    if (!middle_norm) return;
    auto pool = register_module("pool", std::make_shared<torch::nn::Module>());
    const int64_t wide = kNormWidening * width;
    widen_ = pool->register_module(
        "0", std::make_shared<Convolution>(tiny_sizes(width, wide, 1, false), placement));
    auto norm = pool->register_module("1", std::make_shared<torch::nn::Module>());
    gain_ = norm->register_parameter("weight", torch::empty({wide}, placement.options()));
    shift_ = norm->register_parameter("bias", torch::empty({wide}, placement.options()));
    narrow_ = pool->register_module(
        "3", std::make_shared<Convolution>(tiny_sizes(wide, width, 1, false), placement));
  }

  torch::Tensor forward(const torch::Tensor& input) const {
    auto x = input;
    if (widen_) {
      const auto normed = torch::group_norm(widen_->forward(x), kNormGroups, gain_, shift_, 1e-5);
      x = x + narrow_->forward(torch::relu(normed));
    }
    auto refined = convolutions_[0]->forward(x);
    for (size_t i = 1; i < convolutions_.size(); ++i) {
      refined = convolutions_[i]->forward(torch::relu(refined));
    }
    return torch::relu(refined + x);
  }

 private:
  std::vector<std::shared_ptr<Convolution>> convolutions_;
  std::shared_ptr<Convolution> widen_, narrow_;  // null without the middle norm
  torch::Tensor gain_, shift_;
};

// Registers the layers of a half under their numbers in the published sequence, which counts layers without weights
// too.
class TinySequence {
 public:
  TinySequence(std::shared_ptr<torch::nn::Module> parent, const TinyAutoencoderOptions& options,
               const ParameterPlacement& placement)
      : parent_(std::move(parent)), options_(options), placement_(placement) {}

  void convolution(const ConvolutionSizes& sizes) {
    auto layer = parent_->register_module(next(), std::make_shared<Convolution>(sizes, placement_));
    steps_.emplace_back([layer](const torch::Tensor& x) { return layer->forward(x); });
  }
  void blocks(int64_t count, bool middle) {
    for (int64_t i = 0; i < count; ++i) {
      auto layer = parent_->register_module(
          next(), std::make_shared<TinyBlock>(options_.width, middle && options_.middle_norm, placement_));
      steps_.emplace_back([layer](const torch::Tensor& x) { return layer->forward(x); });
    }
  }
  void step(std::function<torch::Tensor(const torch::Tensor&)> function) {
    ++number_;
    steps_.push_back(std::move(function));
  }
  std::vector<std::function<torch::Tensor(const torch::Tensor&)>> steps() { return std::move(steps_); }

 private:
  std::string next() { return std::to_string(number_++); }

  std::shared_ptr<torch::nn::Module> parent_;
  const TinyAutoencoderOptions& options_;
  const ParameterPlacement& placement_;
  int64_t number_ = 0;
  std::vector<std::function<torch::Tensor(const torch::Tensor&)>> steps_;
};

// Returns the cost of either half: three stages of blocks, one at the latent's size, and a block at full size.
Cost tiny_half_cost(const TinyAutoencoderOptions& options, const LatentGrid& grid) {
  const auto width = static_cast<double>(options.width);
  const auto latent_pixels =
      static_cast<double>(grid.views * grid.tokens_per_view() * options.latent_patch * options.latent_patch);
  Cost cost;
  double pixels = latent_pixels;
  for (int64_t stage = 0; stage < kHalvings; ++stage) {
    add_convolution(cost, pixels, width, width * static_cast<double>(kBlocksAStage * kConvolutionsABlock), 3);
    if (stage == 0 && options.middle_norm) {
      add_convolution(cost, pixels, width, 2 * static_cast<double>(kNormWidening * kBlocksAStage) * width, 1);
    }
    pixels *= 4;
    add_convolution(cost, pixels, width, width, 3);
  }
  add_convolution(cost, pixels, width, static_cast<double>(kConvolutionsABlock) * width + 3, 3);
  add_convolution(cost, latent_pixels, width, static_cast<double>(options.latent_channels), 3);
  // This counts one view at a time: maps of a block at full size, and the images of all views.
  const double full_size = pixels / static_cast<double>(grid.views);
  cost.working_bytes = bytes_of_floats(full_size * (5 * width + 9 * static_cast<double>(grid.views)));
  return cost;
}

torch::Tensor run_steps(const std::vector<std::function<torch::Tensor(const torch::Tensor&)>>& steps,
                        torch::Tensor x) {
  for (const auto& step : steps) x = step(x);
  return x;
}

}  // namespace

void TinyAutoencoderOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"latent_channels", "channels of a latent pixel"}, latent_channels, {1, 1024});
  visitor.integer({"width", "channels of every map between image and latent"}, width, {1, 1 << 14});
  visitor.boolean({"middle_norm", "blocks at the latent's size start with group norms (TAEF2)"}, middle_norm);
  visitor.integer({"latent_patch", "latent pixels of a token along each side: the DiT's patch size"},
                  latent_patch, {1, 64});
}

void TinyAutoencoderOptions::check() const {}

std::unique_ptr<BackboneArchitecture> TinyAutoencoderOptions::copy() const {
  return std::make_unique<TinyAutoencoderOptions>(*this);
}

std::shared_ptr<Backbone> TinyAutoencoderOptions::make(const ParameterPlacement& placement) const {
  return std::make_shared<TinyAutoencoder>(*this, placement);
}

Cost TinyAutoencoderOptions::encoding_cost(const LatentGrid& grid, int64_t /*last_level*/) const {
  return tiny_half_cost(*this, grid);
}

Cost TinyAutoencoderOptions::decoding_cost(const LatentGrid& grid) const {
  return tiny_half_cost(*this, grid);
}

TinyAutoencoder::TinyAutoencoder(const TinyAutoencoderOptions& options, const ParameterPlacement& placement)
    : options_((options.check(), options)) {
  const int64_t width = options_.width;
  const auto half = [&](const char* name) {
    return TinySequence(register_module(name, std::make_shared<torch::nn::Module>()), options_, placement);
  };
  auto encoder = half("encoder");
  encoder.convolution(tiny_sizes(3, width, 3, true));
  encoder.blocks(1, false);
  for (int64_t stage = 1; stage <= kHalvings; ++stage) {
    auto halving = tiny_sizes(width, width, 3, false);
    halving.stride = 2;
    encoder.convolution(halving);
    encoder.blocks(kBlocksAStage, stage == kHalvings);
  }
  encoder.convolution(tiny_sizes(width, options_.latent_channels, 3, true));
  encoder_ = encoder.steps();

  auto decoder = half("decoder");
  decoder.step([](const torch::Tensor& x) { return torch::tanh(x / 3) * 3; });
  decoder.convolution(tiny_sizes(options_.latent_channels, width, 3, true));
  decoder.step([](const torch::Tensor& x) { return torch::relu(x); });
  for (int64_t stage = 0; stage < kHalvings; ++stage) {
    decoder.blocks(kBlocksAStage, stage == 0);
    decoder.step([](const torch::Tensor& x) {
      return torch::upsample_nearest2d(x, {2 * x.size(2), 2 * x.size(3)});
    });
    decoder.convolution(tiny_sizes(width, width, 3, false));
  }
  decoder.blocks(1, false);
  decoder.convolution(tiny_sizes(width, 3, 3, true));
  decoder_ = decoder.steps();
}

torch::Tensor TinyAutoencoder::latents_of(const torch::Tensor& images) const {
  return run_steps(encoder_, images);
}

torch::Tensor TinyAutoencoder::images_of(const torch::Tensor& latents) const {
  return run_steps(decoder_, latents);
}

std::vector<torch::Tensor> TinyAutoencoder::encode(const torch::Tensor& images, int64_t last_level,
                                                   std::vector<AttentionTap>* /*taps*/) const {
  require_level(last_level);
  require_images(images);
  options_.grid_of(images.size(0), images.size(2), images.size(3));
  std::vector<torch::Tensor> views;
  for (int64_t view = 0; view < images.size(0); ++view) {
    views.push_back(tokens_of_latents(latents_of(images.narrow(0, view, 1)), options_.latent_patch));
  }
  return {torch::cat(views)};
}

torch::Tensor TinyAutoencoder::decoded_view(const torch::Tensor& latents) const { return images_of(latents); }

Autoencoding TinyAutoencoder::autoencode(const torch::Tensor& images,
                                         const torch::Generator& /*generator*/) const {
  Autoencoding result;
  const auto latents = latents_of(images);
  result.images = images_of(latents);
  // This asks for latents of deviation 1, where the decoder's bound leaves them nearly as they are.
  result.divergence = latents.square().mean() / 2;
  return result;
}

void TinyAutoencoder::initialise(const torch::Generator& generator) {
  initialise_parameters(*this, MatrixInitialisation::kFanInUniform, generator);
}

}  // namespace gld
