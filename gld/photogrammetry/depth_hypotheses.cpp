#include "gld/photogrammetry/depth_hypotheses.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace gld {

PlacedPhotographs nearest_photographs(const PlacedPhotographs& placed) {
  std::vector<size_t> order(placed.photographs.size());
  std::iota(order.begin(), order.end(), size_t{0});
  const auto apart = [&](size_t i) {
    return (placed.photographs[i].camera.world_from_camera.translation() -
            placed.target.world_from_camera.translation())
        .squaredNorm();
  };
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return apart(a) < apart(b); });
  order.resize(std::min(order.size(), kHypothesisPhotographs));
  PlacedPhotographs nearest{{}, placed.target, placed.depth, placed.carry};
  for (const size_t i : order) nearest.photographs.push_back(placed.photographs[i]);
  return nearest;
}

DepthHypothesis depth_hypothesis(const PlacedPhotographs& placed, double factor) {
  TargetDepth depth = placed.depth;
  for (double& value : depth.values) value *= factor;
  const auto carried = carry_pictures_to(placed.photographs, placed.target, depth, placed.carry);
  const size_t pixels = depth.values.size();
  DepthHypothesis mean{std::vector<float>(3 * pixels, 0.0F), std::vector<float>(pixels, 0.0F),
                       std::vector<float>(pixels, 0.0F)};
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    float count = 0;
    float* colour = mean.rgb.data() + 3 * pixel;
    for (const CarriedPicture& picture : carried) {
      if (picture.seen[pixel] == 0) continue;
      count += 1;
      for (size_t c = 0; c < 3; ++c) colour[c] += picture.rgb[3 * pixel + c];
    }
    if (count == 0) continue;
    for (size_t c = 0; c < 3; ++c) colour[c] /= count;
    mean.shown[pixel] = count / static_cast<float>(kHypothesisPhotographs);
    for (const CarriedPicture& picture : carried) {
      if (picture.seen[pixel] == 0) continue;
      for (size_t c = 0; c < 3; ++c)
        mean.disagreement[pixel] += std::abs(picture.rgb[3 * pixel + c] - colour[c]) / (3 * count);
    }
  }
  return mean;
}

}  // namespace gld
