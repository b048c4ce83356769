#pragma once

#include "gld/photogrammetry/depth_hypotheses.h"
#include "models/layers/convolution.h"
#include "models/layers/layers.h"
#include "models/layers/operation_cost.h"
#include "models/layers/pixel_unet.h"

#include <array>
#include <cstdint>
#include <memory>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// What is known of source views and their depth, of several views at once: what the network sees, and what it mends.
struct DepthEvidence {
  torch::Tensor colours;  // (views, 3, height, width), from 0 to about 1: as bright as the view
  torch::Tensor
      log_depth;  // (views, 1, height, width): log(depth / its median in the view); 0 where not known
  torch::Tensor
      confidence;  // (views, 1, height, width), how far the photographs confirm it; 1 where it is not known
  // (views, 1, height, width): log(what the geometry head says / depth); 0 where either is not known.
  torch::Tensor head;
  // What the nearest other photographs show there at each of kDepthFactors of the depth, less `colours`, (views,
  // factors, 3, height, width), 0 where none shows it; and how many of them do, as a share of kHypothesisPhotographs,
  // (views, factors, height, width).
  torch::Tensor differences;
  torch::Tensor shown;

  std::array<torch::Tensor*, 6> parts() {
    return {&colours, &log_depth, &confidence, &head, &differences, &shown};
  }
};

// This U-Net mends the depth of source views where photographs do not confirm it: between edges that a picture shows,
// at walls without texture, along outlines that a small geometry head blurs. It begins with the depth as it is.
// Parameters are PixelUnet's, and "correction", weight and bias.
class DepthRefinement : public torch::nn::Module {
 public:
  DepthRefinement(const PixelUnetOptions& options, const ParameterPlacement& placement);

  const PixelUnetOptions& options() const { return options_; }

  static constexpr int64_t kInputs = 6 + 4 * static_cast<int64_t>(kDepthFactors.size());

  // Returns what the depth would be mended by where nothing confirms it, a natural logarithm: (views, 1, height,
  // width).
  torch::Tensor forward(const DepthEvidence& views) const;

  // Draws random weights that change nothing.
  void initialise(const torch::Generator& generator);

 private:
  PixelUnetOptions options_;
  PixelUnet pixels_;
  std::shared_ptr<Convolution> correction_;
};

// log(mended depth / depth), at most kLargestCorrection: what photographs confirm stays as it is.
constexpr double kLargestCorrection = 1.5;
inline torch::Tensor depth_correction(const torch::Tensor& confidence, const torch::Tensor& network) {
  return (1 - confidence) * network.clamp(-kLargestCorrection, kLargestCorrection);
}

// Returns the cost of one view with pictures of that size, in pixels.
Cost depth_refinement_cost(const PixelUnetOptions& options, int64_t height, int64_t width);

}  // namespace gld
