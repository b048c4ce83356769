#pragma once

#include "gld/photogrammetry/depth_hypotheses.h"
#include "models/layers/convolution.h"
#include "models/layers/layers.h"
#include "models/layers/operation_cost.h"
#include "models/layers/pixel_unet.h"

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Gives what a pixel of a target view is made of: a share of the picture that a rule laid together from the
// photographs, and one of the colour that they show at each of kDepthFactors. Shares are positive and add up to 1, so
// that no colour is drawn that photographs do not have. A U-Net sees colours and disagreement of all of these and
// chooses; it begins with the rule's picture alone. Parameters are PixelUnet's, and "choice", weight and bias.
class PhotographBlending : public torch::nn::Module {
 public:
  PhotographBlending(const PixelUnetOptions& options, const ParameterPlacement& placement);

  const PixelUnetOptions& options() const { return options_; }

  // Channels of an input: colours of the rule's picture, whether it is shown, its depth, and of every hypothesis its
  // colours, disagreement and share of photographs.
  static constexpr int64_t kInputs = 5 + 5 * static_cast<int64_t>(kDepthFactors.size());

  // Makes of (views, kInputs, height, width) logits of the shares, (views, 1 + hypotheses, height, width), the rule's
  // first.
  torch::Tensor forward(const torch::Tensor& inputs) const;

  // Draws random weights that choose the rule's picture, nearly alone.
  void initialise(const torch::Generator& generator);

 private:
  PixelUnetOptions options_;
  PixelUnet pixels_;
  std::shared_ptr<Convolution> choice_;
};

// Returns the cost of one view with pictures of that size, in pixels.
Cost blending_cost(const PixelUnetOptions& options, int64_t height, int64_t width);

// The colours of target views are chosen from these, with a first dimension of views or without.
struct BlendingCandidates {
  torch::Tensor colours;  // (1 + hypotheses, 3, height, width), the rule's picture first
  torch::Tensor shown;    // (1 + hypotheses, height, width): the share of photographs that show it; of the
                          // rule's picture 1 or 0, where it is filled in from around
  torch::Tensor disagreement;  // (hypotheses, height, width)
  torch::Tensor depth;         // (1, height, width): log(depth / its median); 0 where no source reaches

  std::array<torch::Tensor*, 4> parts() { return {&colours, &shown, &disagreement, &depth}; }
};

// placed is what nearest_photographs() leaves; view is of all of the photographs, by the rule.
BlendingCandidates blending_candidates(const PlacedPhotographs& placed, const PhotographView& view);

// Returns them as the network sees them: (views, kInputs, height, width).
torch::Tensor blending_inputs(const BlendingCandidates& views);

// Makes shares of logits, (views, 1 + hypotheses, height, width): a hypothesis that no photograph shows has none.
torch::Tensor blending_shares(const BlendingCandidates& views, const torch::Tensor& logits);

// Returns the views' pictures by these shares: (views, 3, height, width).
torch::Tensor blended(const BlendingCandidates& views, const torch::Tensor& shares);

// Returns what the network chooses in views: (views, 1 + hypotheses, height, width).
torch::Tensor chosen_shares(const PhotographBlending& blending, const BlendingCandidates& views);

}  // namespace gld
