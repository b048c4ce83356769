#include "models/depth_refinement/depth_refinement.h"

#include "gld/cameras/image_size.h"
#include "models/layers/initialisation.h"

#include <torch/autograd.h>

namespace gld {

DepthRefinement::DepthRefinement(const PixelUnetOptions& options, const ParameterPlacement& placement)
    : options_(options), pixels_(*this, options, kInputs, placement) {
  correction_ = register_module(
      "correction",
      std::make_shared<Convolution>(same_size_convolution(options_.channels.front(), 1, 3), placement));
}

torch::Tensor DepthRefinement::forward(const DepthEvidence& views) const {
  // All are about as large as 1, where they say much.
  const auto inputs = torch::cat({views.colours - 0.5, views.log_depth, views.confidence - 0.5,
                                  4 * views.head, 4 * views.differences.flatten(1, 2), views.shown - 0.5},
                                 1);
  return correction_->forward(pixels_(inputs));
}

void DepthRefinement::initialise(const torch::Generator& generator) {
  const torch::NoGradGuard no_grad;
  initialise_parameters(*this, MatrixInitialisation::kFanInUniform, generator);
  correction_->weight.zero_();
  correction_->bias.zero_();
}

Cost depth_refinement_cost(const PixelUnetOptions& options, int64_t height, int64_t width) {
  Cost cost = pixel_unet_cost(options, {DepthRefinement::kInputs, 1}, height, width);
  const ImageSize seen = image_within(width, height, options.side);
  // This counts the evidence that its inputs are made of.
  if (options.exists())
    cost.working_bytes +=
        bytes_of_floats(static_cast<double>(DepthRefinement::kInputs * seen.width * seen.height));
  return cost;
}

}  // namespace gld
