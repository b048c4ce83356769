#include "models/blending/photograph_blending.h"

#include "gld/cameras/image_size.h"
#include "gld/photogrammetry/percentile.h"
#include "gld/tensors/tensor_pictures.h"
#include "models/layers/initialisation.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr auto kHypotheses = static_cast<int64_t>(kDepthFactors.size());

// Returns log(depth / its median), 0 where no source reaches: (1, height, width).
torch::Tensor relative_depth(const TargetDepth& depth) {
  std::vector<float> logs(depth.values.size(), 0.0F), known;
  for (size_t i = 0; i < logs.size(); ++i) {
    if (depth.reached[i] == 0) continue;
    logs[i] = static_cast<float>(std::log(depth.values[i]));
    known.push_back(logs[i]);
  }
  const float middle = known.empty() ? 0.0F : median(known);
  for (size_t i = 0; i < logs.size(); ++i) logs[i] = depth.reached[i] == 0 ? 0.0F : logs[i] - middle;
  return planes_of(logs, 1, depth.width, depth.height);
}

}  // namespace

PhotographBlending::PhotographBlending(const PixelUnetOptions& options, const ParameterPlacement& placement)
    : options_(options), pixels_(*this, options, kInputs, placement) {
  choice_ = register_module(
      "choice", std::make_shared<Convolution>(
                    same_size_convolution(options_.channels.front(), 1 + kHypotheses, 3), placement));
}

torch::Tensor PhotographBlending::forward(const torch::Tensor& inputs) const {
  return choice_->forward(pixels_(inputs));
}

void PhotographBlending::initialise(const torch::Generator& generator) {
  const torch::NoGradGuard no_grad;
  initialise_parameters(*this, MatrixInitialisation::kFanInUniform, generator);
  constexpr float kNearlyAlone = 5;
  choice_->weight.zero_();
  choice_->bias.zero_();
  choice_->bias[0] = kNearlyAlone;
}

Cost blending_cost(const PixelUnetOptions& options, int64_t height, int64_t width) {
  Cost cost = pixel_unet_cost(options, {PhotographBlending::kInputs, 1 + kHypotheses}, height, width);
  const ImageSize seen = image_within(width, height, options.side);
  // Colours of all hypotheses.
  if (options.exists())
    cost.working_bytes +=
        bytes_of_floats(static_cast<double>(4 * (1 + kHypotheses) * seen.width * seen.height));
  return cost;
}

BlendingCandidates blending_candidates(const PlacedPhotographs& placed, const PhotographView& view) {
  const int64_t height = view.height, width = view.width;
  std::vector<float> known(view.variance.size());
  for (size_t pixel = 0; pixel < known.size(); ++pixel) known[pixel] = view.shown(pixel) ? 1.0F : 0.0F;
  std::vector<torch::Tensor> colours = {planes_of(filled(view), 3, width, height)};
  std::vector<torch::Tensor> shown = {planes_of(known, 1, width, height)}, disagreement;
  for (const double factor : kDepthFactors) {
    const DepthHypothesis hypothesis = depth_hypothesis(placed, factor);
    colours.push_back(planes_of(hypothesis.rgb, 3, width, height));
    shown.push_back(planes_of(hypothesis.shown, 1, width, height));
    disagreement.push_back(planes_of(hypothesis.disagreement, 1, width, height));
  }
  return {torch::stack(colours), torch::cat(shown), torch::cat(disagreement), relative_depth(placed.depth)};
}

torch::Tensor blending_inputs(const BlendingCandidates& views) {
  const auto rule = views.colours.narrow(1, 0, 1);
  const auto hypotheses = views.colours.narrow(1, 1, kHypotheses),
             shown = views.shown.narrow(1, 1, kHypotheses);
  const auto off = torch::where(shown.unsqueeze(2) > 0, hypotheses - rule, torch::zeros({}, rule.options()));
  // All are about as large as 1, where they say much.
  return torch::cat({rule.squeeze(1) - 0.5, views.shown.narrow(1, 0, 1), views.depth, 2 * off.flatten(1, 2),
                     8 * views.disagreement, shown - 0.5},
                    1);
}

torch::Tensor blending_shares(const BlendingCandidates& views, const torch::Tensor& logits) {
  const auto absent = torch::cat({torch::zeros_like(views.shown.narrow(1, 0, 1), torch::kBool),
                                  views.shown.narrow(1, 1, kHypotheses) <= 0},
                                 1);
  return logits.masked_fill(absent, -std::numeric_limits<float>::infinity()).softmax(1);
}

torch::Tensor blended(const BlendingCandidates& views, const torch::Tensor& shares) {
  return (views.colours * shares.unsqueeze(2)).sum(1);
}

torch::Tensor chosen_shares(const PhotographBlending& blending, const BlendingCandidates& views) {
  return blending_shares(views, blending.forward(blending_inputs(views)));
}

}  // namespace gld
