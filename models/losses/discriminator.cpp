#include "models/losses/discriminator.h"

#include "models/losses/spectral_convolution.h"

#include <string>

namespace gld {

void ConvolutionalDiscriminatorOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"channels", "channels of the first layer"}, channels, {1, 4096});
  visitor.integer({"layers", "layers of stride 2"}, layers, {1, 8});
}

ConvolutionalDiscriminator::ConvolutionalDiscriminator(const ConvolutionalDiscriminatorOptions& options,
                                                       const ParameterPlacement& placement) {
  int64_t in_channels = 3, out_channels = options.channels;
  for (int64_t layer = 0; layer < options.layers; ++layer) {
    SpectralConvolutionSizes sizes;
    sizes.in_channels = in_channels;
    sizes.out_channels = out_channels;
    sizes.kernel = {4, 4};
    sizes.stride = 2;
    sizes.padding = ConvolutionPadding::kZeros;
    layers_.push_back(register_module("layer" + std::to_string(layer),
                                      std::make_shared<SpectralConvolution>(sizes, placement)));
    in_channels = out_channels;
    out_channels *= 2;
  }
  SpectralConvolutionSizes last;
  last.in_channels = in_channels;
  last.out_channels = 1;
  last.kernel = {3, 3};
  last.padding = ConvolutionPadding::kZeros;
  layers_.push_back(register_module("last", std::make_shared<SpectralConvolution>(last, placement)));
}

torch::Tensor ConvolutionalDiscriminator::logits(const torch::Tensor& images) {
  torch::Tensor x = images;
  for (const auto& layer : layers_) {
    x = layer->forward(x);
    if (layer != layers_.back()) x = torch::leaky_relu(x, 0.2);
  }
  return x.flatten(1);
}

void ConvolutionalDiscriminator::initialise(const torch::Generator& generator) {
  for (const auto& layer : layers_) layer->initialise(generator);
}

}  // namespace gld
