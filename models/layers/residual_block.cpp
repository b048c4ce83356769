#include "models/layers/residual_block.h"

namespace gld {

GroupNorm::GroupNorm(const GroupNormSizes& sizes, const ParameterPlacement& placement) : sizes_(sizes) {
  weight_ = register_parameter("weight", torch::empty({sizes.channels}, placement.options()));
  bias_ = register_parameter("bias", torch::empty({sizes.channels}, placement.options()));
}

torch::Tensor GroupNorm::forward(const torch::Tensor& x) const {
  return torch::group_norm(x, sizes_.groups, weight_, bias_, sizes_.epsilon);
}

ResidualBlock::ResidualBlock(const ResidualBlockSizes& sizes, const ParameterPlacement& placement) {
  const auto norm = [&](const char* name, int64_t channels) {
    return register_module(
        name, std::make_shared<GroupNorm>(GroupNormSizes{channels, sizes.groups, sizes.epsilon}, placement));
  };
  const auto convolution = [&](const char* name, int64_t inputs, int64_t kernel) {
    return register_module(
        name, std::make_shared<Convolution>(same_size_convolution(inputs, sizes.outputs, kernel), placement));
  };
  norm1_ = norm("norm1", sizes.inputs);
  conv1_ = convolution("conv1", sizes.inputs, 3);
  if (sizes.time_channels > 0) {
    time_ = register_module(
        "time_emb_proj",
        std::make_shared<Linear>(
            LinearSizes{sizes.time_channels, sizes.outputs, true, 1, LinearPacking::kNever}, placement));
  }
  norm2_ = norm("norm2", sizes.outputs);
  conv2_ = convolution("conv2", sizes.outputs, 3);
  if (sizes.inputs != sizes.outputs) shortcut_ = convolution("conv_shortcut", sizes.inputs, 1);
}

torch::Tensor ResidualBlock::forward(const torch::Tensor& x, const torch::Tensor& time) const {
  auto hidden = conv1_->forward(torch::silu(norm1_->forward(x)));
  if (time_) hidden = hidden + time_->forward(torch::silu(time)).unsqueeze(-1).unsqueeze(-1);
  const auto refined = conv2_->forward(torch::silu(norm2_->forward(hidden)));
  return (shortcut_ ? shortcut_->forward(x) : x) + refined;
}

}  // namespace gld
