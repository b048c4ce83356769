#include "models/losses/spectral_convolution.h"

#include <cmath>

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr double kNormFloor = 1e-12;
constexpr int kStartIterations = 15;

torch::Tensor unit(const torch::Tensor& vector) { return vector / vector.norm().clamp_min(kNormFloor); }

}  // namespace

SpectralConvolution::SpectralConvolution(const SpectralConvolutionSizes& sizes,
                                         const ParameterPlacement& placement)
    : sizes_(sizes) {
  std::vector<int64_t> shape = {sizes.out_channels, sizes.in_channels};
  shape.insert(shape.end(), sizes.kernel.begin(), sizes.kernel.end());
  bias_ = register_parameter("bias", torch::empty({sizes.out_channels}, placement.options()));
  weight_ = register_parameter("weight_orig", torch::empty(shape, placement.options()));
  left_ = register_buffer("weight_u", torch::empty({sizes.out_channels}, placement.options()));
  right_ =
      register_buffer("weight_v", torch::empty({weight_.numel() / sizes.out_channels}, placement.options()));
}

void SpectralConvolution::iterate() {
  const torch::NoGradGuard no_grad;
  const auto matrix = weight_.flatten(1);
  right_.copy_(unit(torch::mv(matrix.t(), left_)));
  left_.copy_(unit(torch::mv(matrix, right_)));
}

torch::Tensor SpectralConvolution::normalised_weight() {
  if (is_training()) iterate();
  // The vectors are constants for the gradient; clones, because the next iteration writes into them.
  const auto norm = torch::dot(left_.clone(), torch::mv(weight_.flatten(1), right_.clone()));
  return weight_ / norm;
}

torch::Tensor SpectralConvolution::forward(const torch::Tensor& x) {
  const auto weight = normalised_weight();
  const int64_t border = (sizes_.kernel.front() - 1) / 2;
  const bool flat = sizes_.kernel.size() == 1;
  if (sizes_.padding == ConvolutionPadding::kCircular && border > 0) {
    const auto length = x.size(2);
    const auto padded = torch::cat({x.narrow(2, length - border, border), x, x.narrow(2, 0, border)}, 2);
    return torch::conv1d(padded, weight, bias_, sizes_.stride);
  }
  const int64_t zeros = sizes_.padding == ConvolutionPadding::kZeros ? border : 0;
  return flat ? torch::conv1d(x, weight, bias_, sizes_.stride, zeros)
              : torch::conv2d(x, weight, bias_, sizes_.stride, zeros);
}

void SpectralConvolution::initialise(const torch::Generator& generator) {
  const torch::NoGradGuard no_grad;
  const double bound = 1.0 / std::sqrt(static_cast<double>(right_.numel()));
  weight_.copy_(torch::empty(weight_.sizes(), torch::kFloat32).uniform_(-bound, bound, generator));
  bias_.copy_(torch::empty(bias_.sizes(), torch::kFloat32).uniform_(-bound, bound, generator));
  left_.copy_(unit(torch::empty(left_.sizes(), torch::kFloat32).normal_(0.0, 1.0, generator)));
  for (int i = 0; i < kStartIterations; ++i) iterate();
}

}  // namespace gld
