#include "bench/splatting/dense_rendering.h"

#include "gld/kernels/kernel_table.h"
#include "gld/machine/timing.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <torch/autograd.h>

namespace gld {
namespace {

// 16 MiB a tensor: about what stays in the caches of two cores, and large enough that an operation's start costs
// nothing.
constexpr int64_t kNumbersABlock = 1 << 22;

// Renders some pixels, (pixels, channels).
torch::Tensor render_block(const DenseSplats& splats, const torch::Tensor& pixels) {
  const auto dx = pixels.select(1, 0).unsqueeze(1) - splats.places.select(1, 0);
  const auto dy = pixels.select(1, 1).unsqueeze(1) - splats.places.select(1, 1);
  const auto power = dx * (dx * (-0.5 * splats.conics.select(1, 0)) - dy * splats.conics.select(1, 1)) -
                     dy * dy * (0.5 * splats.conics.select(1, 2));
  const auto value = splats.opacities * power.exp();
  const auto faint = value.detach() < splats.least_alpha;
  auto alpha = value.clamp_max(kDensestAlpha).masked_fill(faint, 0);
  const auto logarithms = torch::log1p(-alpha);
  const auto left = logarithms.cumsum(1);
  alpha = alpha.masked_fill(left.detach() < std::log(splats.least_transmittance), 0);
  return (alpha * (left - logarithms).exp()).matmul(splats.features);
}

}  // namespace

DenseSplats dense_splats(const GaussianSet& set, const SplatView& view, const SplatFeatures& features) {
  const int64_t count = view.size();
  const auto real = torch::kFloat32;
  DenseSplats dense{torch::empty({count, 2}, real),
                    torch::empty({count, 3}, real),
                    torch::empty({count}, real),
                    torch::empty({count, features.channels}, real),
                    view.camera.width,
                    view.camera.height,
                    view.camera.least_alpha,
                    static_cast<double>(view.camera.least_transmittance)};
  for (int64_t i = 0; i < count; ++i) {
    const VisibleSplat& splat = view.splats[static_cast<size_t>(i)];
    ProjectedGaussian projected;
    project_gaussian(gaussian_shape(set, splat.index), view.camera, projected);
    float* const conic = dense.conics.data_ptr<float>() + 3 * i;
    conic[0] = static_cast<float>(projected.covariance[2] / projected.determinant);
    conic[1] = static_cast<float>(-projected.covariance[1] / projected.determinant);
    conic[2] = static_cast<float>(projected.covariance[0] / projected.determinant);
    for (int k = 0; k < 2; ++k)
      dense.places.data_ptr<float>()[2 * i + k] = static_cast<float>(projected.mean[k]);
    dense.opacities.data_ptr<float>()[i] = static_cast<float>(projected.opacity);
    const float* from = features.values + (features.by_index ? splat.index : i) * features.channels;
    std::copy(from, from + features.channels, dense.features.data_ptr<float>() + i * features.channels);
  }
  return dense;
}

DenseRendering render_densely(const DenseSplats& splats, const torch::Tensor& of_picture) {
  const bool backward = of_picture.defined();
  const torch::AutoGradMode gradients(backward);
  DenseSplats inputs = splats;
  DenseRendering result;
  const int64_t pixels = splats.width * splats.height, channels = splats.features.size(1);
  const int64_t block = std::max<int64_t>(1, kNumbersABlock / std::max<int64_t>(1, splats.features.size(0)));
  const auto number = torch::arange(pixels, torch::kInt64);
  const auto places = torch::stack({number.remainder(splats.width).to(torch::kFloat32) + 0.5,
                                    number.floor_divide(splats.width).to(torch::kFloat32) + 0.5},
                                   1);
  torch::Tensor of_pixels;
  if (backward) {
    of_pixels = of_picture.reshape({channels, pixels}).t().contiguous();
    for (torch::Tensor* leaf : {&inputs.places, &inputs.conics, &inputs.opacities, &inputs.features})
      *leaf = leaf->detach().requires_grad_(true);
    result.of_places = torch::zeros_like(splats.places);
    result.of_conics = torch::zeros_like(splats.conics);
    result.of_opacities = torch::zeros_like(splats.opacities);
    result.of_features = torch::zeros_like(splats.features);
  }
  std::vector<torch::Tensor> parts;
  for (int64_t begin = 0; begin < pixels; begin += block) {
    const int64_t end = std::min(begin + block, pixels);
    torch::Tensor part;
    result.forward_seconds += seconds_of([&] { part = render_block(inputs, places.slice(0, begin, end)); });
    parts.push_back(part.detach());
    if (!backward) continue;
    result.backward_seconds += seconds_of([&] {
      const auto found =
          torch::autograd::grad({part}, {inputs.places, inputs.conics, inputs.opacities, inputs.features},
                                {of_pixels.slice(0, begin, end)});
      result.of_places += found[0];
      result.of_conics += found[1];
      result.of_opacities += found[2];
      result.of_features += found[3];
    });
  }
  result.picture = torch::cat(parts).t().contiguous().reshape({channels, splats.height, splats.width});
  return result;
}

}  // namespace gld
