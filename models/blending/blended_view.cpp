#include "models/blending/blended_view.h"

#include <algorithm>
#include <cstdint>
#include <vector>

#include <torch/autograd.h>

namespace gld {
namespace {

// Returns what the network chooses in a view, (1 + hypotheses, height, width).
torch::Tensor shares_in(const PhotographBlending& blending, const PlacedPhotographs& nearest,
                        const PhotographView& view) {
  BlendingCandidates views = blending_candidates(nearest, view);
  for (torch::Tensor* part : views.parts()) *part = part->unsqueeze(0);
  return chosen_shares(blending, views)[0];
}

// Returns the longest side of the target and of all photographs, in pixels.
int64_t longest_side(const PlacedPhotographs& placed) {
  int64_t longest = std::max(placed.target.width, placed.target.height);
  for (const PicturedView& view : placed.photographs) longest = std::max({longest, view.width, view.height});
  return longest;
}

// A thousandth of a colour is less than what a file of 8 bits keeps.
constexpr float kNegligibleShare = 1e-3F;

// Gives of each pixel the mean of colours by their shares, and the variance of its error: the mean of theirs, and what
// they are apart (the law of total variance), mean over the colours.
class ColourMixture {
 public:
  explicit ColourMixture(size_t pixels)
      : shares_(pixels), variances_(pixels), squares_(pixels), sums_(3 * pixels) {}

  void add(size_t pixel, float share, const float* colour, float variance) {
    shares_[pixel] += share;
    variances_[pixel] += share * variance;
    for (size_t c = 0; c < 3; ++c) {
      sums_[3 * pixel + c] += share * colour[c];
      squares_[pixel] += share * colour[c] * colour[c] / 3;
    }
  }

  bool known(size_t pixel) const { return shares_[pixel] > 0; }
  // Writes the colour and returns its variance.
  float take(size_t pixel, float* colour) const {
    float mean_square = 0;
    for (size_t c = 0; c < 3; ++c) {
      const float mean = sums_[3 * pixel + c] / shares_[pixel];
      mean_square += mean * mean / 3;
      colour[c] = std::clamp(mean, 0.0F, 1.0F);
    }
    return (variances_[pixel] + std::max(0.0F, squares_[pixel] - shares_[pixel] * mean_square)) /
           shares_[pixel];
  }

 private:
  std::vector<float> shares_, variances_, squares_, sums_;
};

}  // namespace

void blend_photographs(const PhotographBlending& blending, const PlacedPhotographs& placed,
                       PhotographView& view) {
  if (view.shown_share() == 0) return;
  const torch::NoGradGuard no_gradients;
  PlacedPhotographs nearest = nearest_photographs(placed);
  const int64_t side = blending.options().side;
  torch::Tensor shares;
  if (longest_side(placed) <= side) {
    shares = shares_in(blending, nearest, view);
  } else {
    const PlacedPhotographs small = reduced(placed, side);
    shares = shares_in(blending, nearest_photographs(small), view_from_photographs(small));
  }
  // Hypotheses are taken one after the other: of a large picture all of them would be a gigabyte.
  const auto share = [&](int64_t number) {
    return torch::upsample_bilinear2d(shares[number].view({1, 1, shares.size(1), shares.size(2)}),
                                      {view.height, view.width}, false)
        .contiguous();
  };
  const auto pixels = static_cast<size_t>(view.width * view.height);
  ColourMixture mixture(pixels);
  const auto rule = share(0);
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    if (view.shown(pixel))
      mixture.add(pixel, rule.data_ptr<float>()[pixel], view.rgb.data() + 3 * pixel, view.variance[pixel]);
  }
  const std::vector<uint8_t> reached = nearest.depth.reached;
  for (size_t number = 0; number < kDepthFactors.size(); ++number) {
    const auto of_this = share(static_cast<int64_t>(number) + 1);
    const float* shares_of_this = of_this.data_ptr<float>();
    // Photographs are asked only where it counts: most pixels have a share of few depths.
    for (size_t pixel = 0; pixel < pixels; ++pixel) {
      const bool counts = view.shown(pixel) && shares_of_this[pixel] >= kNegligibleShare;
      nearest.depth.reached[pixel] = counts ? reached[pixel] : 0;
    }
    const DepthHypothesis hypothesis = depth_hypothesis(nearest, kDepthFactors[number]);
    for (size_t pixel = 0; pixel < pixels; ++pixel) {
      if (hypothesis.shown[pixel] == 0) continue;
      const float apart = hypothesis.disagreement[pixel];
      const float variance = hypothesis.shown[pixel] < 1 ? PhotographView::kVarianceOfOne
                                                         : PhotographView::kColourNoise + apart * apart;
      mixture.add(pixel, shares_of_this[pixel], hypothesis.rgb.data() + 3 * pixel, variance);
    }
  }
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    if (mixture.known(pixel)) view.variance[pixel] = mixture.take(pixel, view.rgb.data() + 3 * pixel);
  }
}

}  // namespace gld
