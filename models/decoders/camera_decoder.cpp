#include "models/decoders/camera_decoder.h"

#include "gld/base/error.h"
#include "gld/cameras/pose_encoding.h"
#include "models/decoders/dpt_trunk.h"

#include <algorithm>
#include <string>

#include <torch/autograd.h>

namespace gld {

CameraDecoder::CameraDecoder(int64_t channels, const ParameterPlacement& placement) : channels_(channels) {
  const auto linear = [&](torch::nn::Module& parent, const char* name, int64_t outputs) {
    return parent.register_module(name, std::make_shared<Linear>(LinearSizes{channels_, outputs}, placement));
  };
  const auto trunk = child_module(*this, "backbone");
  first_ = linear(*trunk, "0", channels_);
  second_ = linear(*trunk, "2", channels_);
  translation_ = linear(*this, "fc_t", 3);
  quaternion_ = linear(*this, "fc_qvec", 4);
  field_of_view_ = linear(*child_module(*this, "fc_fov"), "0", 2);
}

torch::Tensor CameraDecoder::forward(const torch::Tensor& camera_tokens) const {
  if (camera_tokens.dim() != 2 || camera_tokens.size(0) == 0 || camera_tokens.size(1) != channels_) {
    fail({"camera decoder", "camera tokens (views, " + std::to_string(channels_) + ")",
          "a tensor of shape " + c10::str(camera_tokens.sizes()), "give those of the last level"});
  }
  const auto hidden = torch::relu(second_->forward(torch::relu(first_->forward(camera_tokens))));
  return torch::cat({translation_->forward(hidden), quaternion_->forward(hidden),
                     torch::relu(field_of_view_->forward(hidden))},
                    -1);
}

void CameraDecoder::initialise_output() {
  const torch::NoGradGuard no_grad;
  quaternion_->bias.slice(0, 3, 4).fill_(1);
  field_of_view_->bias.fill_(1);
}

std::vector<Camera> decoded_cameras(const torch::Tensor& encodings, const ImageSize& size) {
  const auto values = encodings.detach().to(torch::kCPU, torch::kFloat64).contiguous();
  std::vector<Camera> cameras;
  for (int64_t view = 0; view < values.size(0); ++view) {
    PoseEncoding encoding{};
    std::copy_n(values[view].data_ptr<double>(), encoding.size(), encoding.begin());
    cameras.push_back(camera_of_pose_encoding(encoding, size));
  }
  return cameras;
}

}  // namespace gld
