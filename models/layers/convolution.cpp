#include "models/layers/convolution.h"

#include "gld/base/error.h"

#include <string>

namespace gld {
namespace {

void require_maps(const torch::Tensor& x, int64_t channels, const std::string& layer) {
  if (x.dim() != 4 || x.size(1) != channels) {
    fail({layer, "(batch, " + std::to_string(channels) + ", height, width)",
          "a tensor of shape " + c10::str(x.sizes()), "check the sizes in the model's configuration"});
  }
}

}  // namespace

ConvolutionSizes same_size_convolution(int64_t in_channels, int64_t out_channels, int64_t kernel) {
  ConvolutionSizes sizes;
  sizes.in_channels = in_channels;
  sizes.out_channels = out_channels;
  sizes.kernel = kernel;
  sizes.padding = kernel / 2;
  return sizes;
}

Convolution::Convolution(const ConvolutionSizes& sizes, const ParameterPlacement& placement) : sizes_(sizes) {
  weight = register_parameter(
      "weight",
      torch::empty({sizes.out_channels, sizes.in_channels, sizes.kernel, sizes.kernel}, placement.options()));
  if (sizes.bias) bias = register_parameter("bias", torch::empty({sizes.out_channels}, placement.options()));
}

torch::Tensor Convolution::forward(const torch::Tensor& x) const {
  require_maps(x, sizes_.in_channels, "convolution");
  return torch::conv2d(x, weight, bias, {sizes_.stride, sizes_.stride}, {sizes_.padding, sizes_.padding});
}

BlockUpsampling::BlockUpsampling(const Sizes& sizes, const ParameterPlacement& placement) : sizes_(sizes) {
  weight = register_parameter(
      "weight",
      torch::empty({sizes.channels, sizes.channels, sizes.factor, sizes.factor}, placement.options()));
  bias = register_parameter("bias", torch::empty({sizes.channels}, placement.options()));
}

torch::Tensor BlockUpsampling::forward(const torch::Tensor& x) const {
  require_maps(x, sizes_.channels, "block upsampling");
  return torch::conv_transpose2d(x, weight, bias, {sizes_.factor, sizes_.factor});
}

}  // namespace gld
