#include "models/backbones/camera_encoder.h"

#include "gld/base/error.h"
#include "gld/cameras/pose_encoding.h"

#include <algorithm>
#include <string>

namespace gld {
namespace {

constexpr int64_t kPoseValues = 9;
constexpr int64_t kMlpRatio = 4;
constexpr double kEpsilon = 1e-5;  // of all norms
constexpr double kLeastUnit = 0.1;

}  // namespace

NormalisedCameras normalised_cameras(const std::vector<Camera>& cameras) {
  if (cameras.empty()) fail({"known cameras", "at least one camera", "none", "give one for each view"});
  NormalisedCameras result;
  result.cameras = cameras;
  const Eigen::Isometry3d first_from_world = cameras.front().camera_from_world();
  std::vector<double> distances;
  for (Camera& camera : result.cameras) {
    camera.world_from_camera = first_from_world * camera.world_from_camera;
    distances.push_back(camera.world_from_camera.translation().norm());
  }
  const auto middle = distances.begin() + static_cast<int64_t>((distances.size() - 1) / 2);
  std::nth_element(distances.begin(), middle, distances.end());
  result.unit = std::max(*middle, kLeastUnit);
  for (Camera& camera : result.cameras) camera.world_from_camera.translation() /= result.unit;
  return result;
}

CameraEncoder::CameraEncoder(const CameraEncoderSizes& sizes, const ParameterPlacement& placement)
    : sizes_(sizes) {
  const int64_t channels = sizes_.channels;
  const auto trunk = register_module("trunk", std::make_shared<torch::nn::Module>());
  VitBlockSizes block;
  block.embed_dim = channels;
  block.num_heads = sizes_.num_heads;
  block.hidden_dim = kMlpRatio * channels;
  block.norm_epsilon = kEpsilon;
  for (int64_t i = 0; i < sizes_.depth; ++i) {
    trunk_.push_back(trunk->register_module(std::to_string(i), std::make_shared<VitBlock>(block, placement)));
  }
  token_norm_ = register_module("token_norm", std::make_shared<LayerNorm>(channels, kEpsilon, placement));
  trunk_norm_ = register_module("trunk_norm", std::make_shared<LayerNorm>(channels, kEpsilon, placement));
  const auto branch = register_module("pose_branch", std::make_shared<torch::nn::Module>());
  const auto linear = [&](const char* name, int64_t inputs, int64_t outputs) {
    return branch->register_module(name, std::make_shared<Linear>(LinearSizes{inputs, outputs}, placement));
  };
  hidden_ = linear("fc1", kPoseValues, channels / 2);
  token_ = linear("fc2", channels / 2, channels);
}

torch::Tensor CameraEncoder::forward(const std::vector<Camera>& cameras) const {
  const auto known = normalised_cameras(cameras).cameras;
  const auto views = static_cast<int64_t>(known.size());
  auto values = torch::empty({views, kPoseValues}, torch::kFloat32);
  float* value = values.data_ptr<float>();
  for (const Camera& camera : known) {
    for (const double number : pose_encoding(camera)) *value++ = static_cast<float>(number);
  }
  const auto encodings = values.to(token_norm_->weight.device(), token_norm_->weight.scalar_type());
  auto tokens = token_norm_->forward(token_->forward(torch::gelu(hidden_->forward(encodings)))).unsqueeze(0);
  for (const auto& block : trunk_) tokens = block->forward(tokens, AttentionScope::kLocal, {});
  return trunk_norm_->forward(tokens).view({views, 1, sizes_.channels});
}

}  // namespace gld
