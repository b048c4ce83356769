#pragma once

#include "gld/photogrammetry/depth_hypotheses.h"
#include "models/blending/blending_options.h"
#include "models/layers/convolution.h"
#include "models/layers/layers.h"
#include "models/layers/operation_cost.h"

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// What a pixel of a target view is made of: a share of the picture that a rule laid together from the photographs, and
// one of the colour that they show at each of kDepthFactors. Shares are positive and add up to 1, so that no colour is
// drawn that photographs do not have. A network of convolutions that halve the picture and double it again, with GELU
// between them, sees colours and disagreement of all of these and chooses; it begins with the rule's picture alone.
// Parameters "encoder.I.first", "encoder.I.second", "decoder.I.first", "decoder.I.second", "choice", weight and bias
// each.
class PhotographBlending : public torch::nn::Module {
 public:
  PhotographBlending(const BlendingOptions& options, const ParameterPlacement& placement);

  const BlendingOptions& options() const { return options_; }

  // Channels of an input: colours of the rule's picture, whether it is shown, its depth, and of every hypothesis its
  // colours, disagreement and share of photographs.
  static constexpr int64_t kInputs = 5 + 5 * static_cast<int64_t>(kDepthFactors.size());

  // (views, kInputs, height, width) -> logits of the shares, (views, 1 + hypotheses, height, width), the rule's first.
  torch::Tensor forward(const torch::Tensor& inputs) const;

  // With random weights that choose the rule's picture, nearly alone.
  void initialise(const torch::Generator& generator);

 private:
  struct Pair {
    std::shared_ptr<Convolution> first, second;
    torch::Tensor operator()(const torch::Tensor& x) const;
  };
  struct Widths {
    int64_t inputs = 0, outputs = 0;
  };
  static Pair make_pair(torch::nn::Module& parent, const std::string& name, const Widths& widths,
                        const ParameterPlacement& placement);

  BlendingOptions options_;
  std::vector<Pair> encoder_, decoder_;
  std::shared_ptr<Convolution> choice_;
};

// Of one view with pictures of that size, in pixels.
Cost blending_cost(const BlendingOptions& options, int64_t height, int64_t width);

// What the colours of target views are chosen from, with a first dimension of views or without.
struct BlendingCandidates {
  torch::Tensor colours;  // (1 + hypotheses, 3, height, width), the rule's picture first
  torch::Tensor shown;    // (1 + hypotheses, height, width): the share of photographs that show it; of the
                          // rule's picture 1 or 0, where it is filled in from around
  torch::Tensor disagreement;  // (hypotheses, height, width)
  torch::Tensor depth;         // (1, height, width): log(depth / its median); 0 where no source reaches

  std::array<torch::Tensor*, 4> parts() { return {&colours, &shown, &disagreement, &depth}; }
};

// placed: what nearest_photographs() leaves; view: of all of the photographs, by the rule.
BlendingCandidates blending_candidates(const PlacedPhotographs& placed, const PhotographView& view);

// As the network sees them: (views, kInputs, height, width).
torch::Tensor blending_inputs(const BlendingCandidates& views);

// Logits -> shares, (views, 1 + hypotheses, height, width): a hypothesis that no photograph shows has none.
torch::Tensor blending_shares(const BlendingCandidates& views, const torch::Tensor& logits);

// The views' pictures by these shares: (views, 3, height, width).
torch::Tensor blended(const BlendingCandidates& views, const torch::Tensor& shares);

// What the network chooses in views: (views, 1 + hypotheses, height, width).
torch::Tensor chosen_shares(const PhotographBlending& blending, const BlendingCandidates& views);

}  // namespace gld
