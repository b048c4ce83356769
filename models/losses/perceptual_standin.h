#pragma once

#include "gld/base/options.h"

#include <cstdint>

#include <torch/types.h>

namespace gld {

struct PerceptualStandinOptions : OptionsGroup {
  int64_t scales = 3;  // each halves the images
  double gradient_weight = 1.0;
  double similarity_weight = 0.5;
  double edge_weight = 0.0;

  void visit(FieldVisitor& visitor) override;
};

// Training uses this in the place of LPIPS when no network weights are given. It is, over scales 1, 1/2, 1/4,
// ...:
//   gradient_weight * mean |grad a - grad b| + similarity_weight * (1 - SSIM(a, b)) / 2
//     + edge_weight * mean |e(a) - e(b)|
// with forward differences along rows and columns, and SSIM (Wang et al. 2004, eq. 13) over 7x7 box windows with K1 =
// 0.01, K2 = 0.03 and range 1. e is the root mean square of the differences in a 7x7 window: how strong edges are
// there, wherever exactly they run. The first two alone have their least expected value for blurred pictures where an
// edge's place is uncertain; the third asks for edges as strong as the true ones. Like LPIPS it sees edges and local
// structure rather than the exact value of each pixel; unlike LPIPS it knows nothing of objects. It is 0 for equal
// images, about 0.1 to 0.5 for unrelated ones.
// image, prediction: (batch, 3, height, width), RGB in [0, 1] -> (batch). It is differentiable. The sum over
// scales is divided by how many were asked for; those at which a side is shorter than 7 pixels add nothing, nor do
// edges where a side has 7.
torch::Tensor perceptual_standin(const torch::Tensor& image, const torch::Tensor& prediction,
                                 const PerceptualStandinOptions& options);

}  // namespace gld
