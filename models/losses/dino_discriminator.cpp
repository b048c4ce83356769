#include "models/losses/dino_discriminator.h"

#include "gld/attention/attention.h"
#include "gld/base/error.h"
#include "models/layers/imagenet.h"
#include "models/losses/spectral_convolution.h"
#include "models/weights/weight_loading.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <torch/autograd.h>

namespace gld {

class FrozenDinoBlock : public torch::nn::Module {
 public:
  FrozenDinoBlock(const DinoDiscriminatorOptions& options, const ParameterPlacement& placement)
      : num_heads_(options.num_heads) {
    const int64_t channels = options.embed_dim;
    const auto hidden = static_cast<int64_t>(std::lround(static_cast<double>(channels) * options.mlp_ratio));
    norm1_ = register_module("norm1", std::make_shared<LayerNorm>(channels, 1e-6, placement));
    auto attention_part = register_module("attn", std::make_shared<torch::nn::Module>());
    qkv_ = attention_part->register_module(
        "qkv", std::make_shared<Linear>(LinearSizes{channels, 3 * channels}, placement));
    projection_ = attention_part->register_module(
        "proj", std::make_shared<Linear>(LinearSizes{channels, channels}, placement));
    norm2_ = register_module("norm2", std::make_shared<LayerNorm>(channels, 1e-6, placement));
    auto mlp = register_module("mlp", std::make_shared<torch::nn::Module>());
    expansion_ =
        mlp->register_module("fc1", std::make_shared<Linear>(LinearSizes{channels, hidden}, placement));
    contraction_ =
        mlp->register_module("fc2", std::make_shared<Linear>(LinearSizes{hidden, channels}, placement));
  }

  torch::Tensor forward(const torch::Tensor& x) const {
    const int64_t channels = x.size(2);
    const auto qkv =
        qkv_->forward(norm1_->forward(x)).view({x.size(0), x.size(1), 3, num_heads_, channels / num_heads_});
    AttentionInputs inputs;
    inputs.query = qkv.select(2, 0);
    inputs.key = qkv.select(2, 1);
    inputs.value = qkv.select(2, 2);
    const auto y = x + projection_->forward(attention(inputs).reshape(x.sizes()));
    return y + contraction_->forward(torch::gelu(expansion_->forward(norm2_->forward(y)), "tanh"));
  }

  void zero_key_bias() {
    const torch::NoGradGuard no_grad;
    const int64_t channels = projection_->weight.size(0);
    qkv_->bias.narrow(0, channels, channels).zero_();
  }

 private:
  int64_t num_heads_;
  std::shared_ptr<LayerNorm> norm1_, norm2_;
  std::shared_ptr<Linear> qkv_, projection_, expansion_, contraction_;
};

// Statistics of one sample: each channel over its tokens, then a learned scale and shift.
class DinoHeadNorm : public torch::nn::Module {
 public:
  DinoHeadNorm(int64_t channels, const ParameterPlacement& placement) {
    weight_ = register_parameter("weight", torch::empty({channels}, placement.options()));
    bias_ = register_parameter("bias", torch::empty({channels}, placement.options()));
  }
  // (batch, channels, tokens) -> the same shape
  torch::Tensor forward(const torch::Tensor& x) const {
    const auto centred = x - x.mean(2, /*keepdim=*/true);
    const auto deviation = (centred.square().mean(2, /*keepdim=*/true) + 1e-6).sqrt();
    return centred / deviation * weight_.unsqueeze(1) + bias_.unsqueeze(1);
  }
  void initialise() {
    const torch::NoGradGuard no_grad;
    weight_.fill_(1.0);
    bias_.zero_();
  }

 private:
  torch::Tensor weight_, bias_;
};

// Convolution along the tokens, norm, leaky ReLU; children "0" and "1".
class DinoHeadBlock : public torch::nn::Module {
 public:
  DinoHeadBlock(int64_t channels, int64_t kernel, const ParameterPlacement& placement) {
    SpectralConvolutionSizes sizes;
    sizes.in_channels = sizes.out_channels = channels;
    sizes.kernel = {kernel};
    sizes.padding = ConvolutionPadding::kCircular;
    convolution_ = register_module("0", std::make_shared<SpectralConvolution>(sizes, placement));
    norm_ = register_module("1", std::make_shared<DinoHeadNorm>(channels, placement));
  }
  torch::Tensor forward(const torch::Tensor& x) {
    return torch::leaky_relu(norm_->forward(convolution_->forward(x)), 0.2);
  }
  void initialise(const torch::Generator& generator) {
    convolution_->initialise(generator);
    norm_->initialise();
  }

 private:
  std::shared_ptr<SpectralConvolution> convolution_;
  std::shared_ptr<DinoHeadNorm> norm_;
};

class FrozenDino : public torch::nn::Module {
 public:
  FrozenDino(const DinoDiscriminatorOptions& options, const ParameterPlacement& placement)
      : options_(options) {
    grid_ = options.image_size / options.patch_size;
    patch_embed_ = register_module(
        "patch_embed",
        std::make_shared<PatchEmbed>(PatchEmbedSizes{3, options.embed_dim, options.patch_size}, placement));
    class_token_ =
        register_parameter("cls_token", torch::empty({1, 1, options.embed_dim}, placement.options()));
    positions_ = register_parameter(
        "pos_embed", torch::empty({1, grid_ * grid_ + 1, options.embed_dim}, placement.options()));
    auto blocks = register_module("blocks", std::make_shared<torch::nn::Module>());
    for (int64_t i = 0; i < options.depth; ++i) {
      blocks_.push_back(
          blocks->register_module(std::to_string(i), std::make_shared<FrozenDinoBlock>(options, placement)));
    }
    norm_ = register_module("norm", std::make_shared<LayerNorm>(options.embed_dim, 1e-6, placement));
  }

  void load_weights(const WeightFile& file) {
    load_strict(*this, file);
    for (const auto& block : blocks_) block->zero_key_bias();
    for (auto& parameter : parameters()) parameter.set_requires_grad(false);
  }

  // Makes of images (batch, 3, h, w) in [-1, 1] token maps (batch, embed_dim, tokens): after the last block, then after
  // each key depth.
  std::vector<torch::Tensor> features(const torch::Tensor& images) const {
    torch::Tensor resized = images;
    if (images.size(2) != options_.image_size || images.size(3) != options_.image_size) {
      const std::vector<int64_t> size = {options_.image_size, options_.image_size};
      resized = torch::upsample_bilinear2d(images, size, /*align_corners=*/false);
    }
    const auto patches = patch_embed_->forward_image(imagenet_normalise(0.5 * (resized + 1.0)));
    auto x = torch::cat({class_token_.expand({patches.size(0), 1, -1}), patches}, 1) + positions_;
    std::vector<torch::Tensor> result;
    for (size_t i = 0; i < blocks_.size(); ++i) {
      x = blocks_[i]->forward(x);
      const auto& keys = options_.key_depths;
      if (std::find(keys.begin(), keys.end(), static_cast<int64_t>(i)) != keys.end()) {
        result.push_back(x.narrow(1, 1, x.size(1) - 1).transpose(1, 2));
      }
    }
    result.insert(result.begin(), x.narrow(1, 1, x.size(1) - 1).transpose(1, 2));
    return result;
  }

 private:
  DinoDiscriminatorOptions options_;
  int64_t grid_ = 0;
  std::shared_ptr<PatchEmbed> patch_embed_;
  std::vector<std::shared_ptr<FrozenDinoBlock>> blocks_;
  std::shared_ptr<LayerNorm> norm_;  // in the published file; the judged tokens do not pass it
  torch::Tensor class_token_, positions_;
};

// Its children are "0" (1x1 block), "1.fn" (residual block) and "2" (one logit a token), as published.
class DinoDiscriminatorHead : public torch::nn::Module {
 public:
  DinoDiscriminatorHead(const DinoDiscriminatorOptions& options, const ParameterPlacement& placement) {
    first_ = register_module("0", std::make_shared<DinoHeadBlock>(options.embed_dim, 1, placement));
    auto residual = register_module("1", std::make_shared<torch::nn::Module>());
    second_ = residual->register_module(
        "fn", std::make_shared<DinoHeadBlock>(options.embed_dim, options.kernel_size, placement));
    SpectralConvolutionSizes sizes;
    sizes.in_channels = options.embed_dim;
    sizes.out_channels = 1;
    sizes.kernel = {1};
    last_ = register_module("2", std::make_shared<SpectralConvolution>(sizes, placement));
  }
  // (batch, embed_dim, tokens) -> (batch, tokens)
  torch::Tensor forward(const torch::Tensor& tokens) {
    const auto x = first_->forward(tokens);
    return last_->forward((second_->forward(x) + x) * M_SQRT1_2).flatten(1);
  }
  void initialise(const torch::Generator& generator) {
    first_->initialise(generator);
    second_->initialise(generator);
    last_->initialise(generator);
  }

 private:
  std::shared_ptr<DinoHeadBlock> first_, second_;
  std::shared_ptr<SpectralConvolution> last_;
};

void DinoDiscriminatorOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"embed_dim", "channels of DINO's tokens"}, embed_dim, {1, 65536});
  visitor.integer({"depth", "blocks of DINO"}, depth, {1, 1000});
  visitor.integer({"num_heads", "attention heads of DINO"}, num_heads, {1, 1024});
  visitor.integer({"patch_size", "pixels of DINO's patches"}, patch_size, {1, 1024});
  visitor.real({"mlp_ratio", "hidden width of DINO's feed-forward parts over embed_dim"}, mlp_ratio,
               {0.1, 100.0});
  visitor.integer({"image_size", "pixels of a side of the images that DINO sees"}, image_size, {1, 65536});
  visitor.integers({"key_depths", "blocks whose tokens are judged, beside the last"}, key_depths, {0, 1000});
  visitor.integer({"kernel_size", "tokens under the heads' second convolution"}, kernel_size, {1, 999});
}

void DinoDiscriminatorOptions::check() const {
  if (embed_dim % num_heads != 0) {
    fail({"discriminator.num_heads", "a divisor of embed_dim " + std::to_string(embed_dim),
          std::to_string(num_heads), "change one of them"});
  }
  for (size_t i = 0; i < key_depths.size(); ++i) {
    if (key_depths[i] < depth && (i == 0 || key_depths[i] > key_depths[i - 1])) continue;
    fail({"discriminator.key_depths",
          "blocks from 0 to " + std::to_string(depth - 1) + ", ascending, each once",
          std::to_string(key_depths[i]) + (i == 0 ? "" : " behind " + std::to_string(key_depths[i - 1])),
          "name blocks of that network"});
  }
  if (kernel_size % 2 == 0) {
    fail({"discriminator.kernel_size", "an odd number", std::to_string(kernel_size),
          "use the next odd number"});
  }
}

DinoDiscriminator::DinoDiscriminator(const DinoDiscriminatorOptions& options,
                                     const ParameterPlacement& placement)
    : dino_(std::make_shared<FrozenDino>(options, placement)) {
  options.check();
  auto heads = register_module("heads", std::make_shared<torch::nn::Module>());
  for (size_t i = 0; i <= options.key_depths.size(); ++i) {
    heads_.push_back(heads->register_module(std::to_string(i),
                                            std::make_shared<DinoDiscriminatorHead>(options, placement)));
  }
}

DinoDiscriminator::~DinoDiscriminator() = default;

void DinoDiscriminator::load_dino(const WeightFile& file) { dino_->load_weights(file); }

torch::Tensor DinoDiscriminator::logits(const torch::Tensor& images) {
  const auto features = dino_->features(images);
  std::vector<torch::Tensor> judged;
  for (size_t i = 0; i < heads_.size(); ++i) judged.push_back(heads_[i]->forward(features[i]));
  return torch::cat(judged, 1);
}

void DinoDiscriminator::initialise(const torch::Generator& generator) {
  for (const auto& head : heads_) head->initialise(generator);
}

}  // namespace gld
