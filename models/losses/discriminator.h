#pragma once

#include "gld/base/options.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Tells real images from decoded ones (decoder training).
class Discriminator : public torch::nn::Module {
 public:
  // images: (batch, 3, height, width), RGB in [-1, 1] -> logits (batch, n), large for "real".
  virtual torch::Tensor logits(const torch::Tensor& images) = 0;
  // Draws random weights to train from; what is frozen stays.
  virtual void initialise(const torch::Generator& generator) = 0;
};

class SpectralConvolution;

struct ConvolutionalDiscriminatorOptions : OptionsGroup {
  int64_t channels = 32;  // of the first layer; each layer doubles it
  int64_t layers = 3;     // of stride 2

  void visit(FieldVisitor& visitor) override;
};

// A small patch discriminator (as in Isola et al. 2017, section 3.2) for when no DINO weights are given:
// 4x4 convolutions of stride 2 with leaky ReLU, then one logit a position. All weights are divided by their
// spectral norm.
class ConvolutionalDiscriminator : public Discriminator {
 public:
  ConvolutionalDiscriminator(const ConvolutionalDiscriminatorOptions& options,
                             const ParameterPlacement& placement);
  torch::Tensor logits(const torch::Tensor& images) override;
  void initialise(const torch::Generator& generator) override;

 private:
  std::vector<std::shared_ptr<SpectralConvolution>> layers_;
};

}  // namespace gld
