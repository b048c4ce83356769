#include "models/blending/blended_view.h"

#include <algorithm>
#include <cmath>

#include <torch/autograd.h>

namespace gld {
namespace {

// Of a view as it is looked at, (1 + hypotheses, height, width).
torch::Tensor choices(const PhotographBlending& blending, const PlacedPhotographs& nearest,
                      const PhotographView& view) {
  BlendingCandidates views = blending_candidates(nearest, view);
  for (torch::Tensor* part : {&views.colours, &views.shown, &views.disagreement, &views.depth})
    *part = part->unsqueeze(0);
  return blending.forward(blending_inputs(views))[0];
}

}  // namespace

void blend_photographs(const PhotographBlending& blending, const PlacedPhotographs& placed,
                       PhotographView& view) {
  if (view.shown_share() == 0) return;
  const torch::NoGradGuard no_gradients;
  const PlacedPhotographs nearest = nearest_photographs(placed);
  const int64_t side = blending.options().side;
  torch::Tensor logits;
  if (std::max(view.width, view.height) <= side) {
    logits = choices(blending, nearest, view);
  } else {
    const PlacedPhotographs small = reduced(placed, side);
    logits = choices(blending, nearest_photographs(small), view_from_photographs(small));
  }
  // One hypothesis after the other: of a large picture all of them would be a gigabyte.
  const auto shares = logits.softmax(0);
  const auto share = [&](int64_t number) {
    return torch::upsample_bilinear2d(shares[number].view({1, 1, shares.size(1), shares.size(2)}),
                                      {view.height, view.width}, false)
        .contiguous();
  };
  const auto pixels = static_cast<size_t>(view.width * view.height);
  const auto rule = share(0);
  std::vector<float> total(rule.data_ptr<float>(), rule.data_ptr<float>() + pixels);
  std::vector<float> sum(3 * pixels);
  for (size_t i = 0; i < sum.size(); ++i) sum[i] = total[i / 3] * view.rgb[i];
  for (size_t number = 0; number < kDepthFactors.size(); ++number) {
    const DepthHypothesis hypothesis = depth_hypothesis(nearest, kDepthFactors[number]);
    const auto of_this = share(static_cast<int64_t>(number) + 1);
    const float* weights = of_this.data_ptr<float>();
    for (size_t pixel = 0; pixel < pixels; ++pixel) {
      if (hypothesis.shown[pixel] == 0) continue;
      total[pixel] += weights[pixel];
      for (size_t c = 0; c < 3; ++c) sum[3 * pixel + c] += weights[pixel] * hypothesis.rgb[3 * pixel + c];
    }
  }
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    if (!view.shown(pixel) || total[pixel] <= 0) continue;
    for (size_t c = 0; c < 3; ++c)
      view.rgb[3 * pixel + c] = std::clamp(sum[3 * pixel + c] / total[pixel], 0.0F, 1.0F);
  }
}

}  // namespace gld
