#include "models/decoders/pixel_refinement.h"

#include "models/layers/initialisation.h"

#include <string>

#include <torch/autograd.h>

namespace gld {

PixelRefinement::PixelRefinement(const Sizes& sizes, const ParameterPlacement& placement) {
  for (int64_t layer = 0; layer < sizes.layers; ++layer) {
    const int64_t inputs = layer == 0 ? 3 : sizes.channels;
    const int64_t outputs = layer + 1 == sizes.layers ? 3 : sizes.channels;
    layers_.push_back(
        register_module(std::to_string(layer),
                        std::make_shared<Convolution>(same_size_convolution(inputs, outputs, 3), placement)));
  }
}

torch::Tensor PixelRefinement::forward(const torch::Tensor& pixels) const {
  std::vector<torch::Tensor> refined;
  for (int64_t view = 0; view < pixels.size(0); ++view) {
    const auto drawn = pixels.narrow(0, view, 1);
    torch::Tensor x = drawn;
    for (const auto& layer : layers_) {
      x = layer->forward(x);
      if (layer != layers_.back()) x = torch::gelu(x);
    }
    refined.push_back(drawn + x);
  }
  return torch::cat(refined);
}

void PixelRefinement::initialise(const torch::Generator& generator) {
  const torch::NoGradGuard no_grad;
  initialise_parameters(*this, MatrixInitialisation::kXavierUniform, generator);
  layers_.back()->weight.zero_();
  layers_.back()->bias.zero_();
}

}  // namespace gld
