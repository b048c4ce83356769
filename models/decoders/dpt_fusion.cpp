#include "models/decoders/dpt_fusion.h"

namespace gld {

ResidualConvolution::ResidualConvolution(int64_t channels, FusionResidual residual,
                                         const ParameterPlacement& placement)
    : residual_(residual) {
  first_ = register_module(
      "conv1", std::make_shared<Convolution>(same_size_convolution(channels, channels, 3), placement));
  second_ = register_module(
      "conv2", std::make_shared<Convolution>(same_size_convolution(channels, channels, 3), placement));
}

torch::Tensor ResidualConvolution::forward(const torch::Tensor& x) const {
  const auto rectified = torch::relu(x);
  const auto refined = second_->forward(torch::relu(first_->forward(rectified)));
  return (residual_ == FusionResidual::kRaw ? x : rectified) + refined;
}

FusionBlock::FusionBlock(const Sizes& sizes, const ParameterPlacement& placement) {
  if (sizes.inputs == FusionInputs::kRunningAndLateral) {
    lateral_unit_ = register_module(
        "resConfUnit1", std::make_shared<ResidualConvolution>(sizes.channels, sizes.residual, placement));
  }
  running_unit_ = register_module(
      "resConfUnit2", std::make_shared<ResidualConvolution>(sizes.channels, sizes.residual, placement));
  mix_ = register_module(
      "out_conv",
      std::make_shared<Convolution>(same_size_convolution(sizes.channels, sizes.channels, 1), placement));
}

torch::Tensor FusionBlock::forward(const torch::Tensor& running, const torch::Tensor& lateral,
                                   const MapSize& size) const {
  const auto merged = lateral_unit_ ? running + lateral_unit_->forward(lateral) : running;
  const auto refined = running_unit_->forward(merged);
  return mix_->forward(
      torch::upsample_bilinear2d(refined, {size.height, size.width}, /*align_corners=*/true));
}

}  // namespace gld
