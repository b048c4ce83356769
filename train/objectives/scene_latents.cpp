#include "train/objectives/scene_latents.h"

#include <array>
#include <utility>

namespace gld {
namespace {

std::array<torch::Tensor*, 5> tensors_of(SceneLatents& latents) {
  DitSceneInputs& shown = latents.shown;
  return {&latents.clean, &shown.source_features, &shown.deeper_level, &shown.warp_agreement,
          &shown.warped_features};
}

SceneLatents converted(const SceneLatents& latents, const torch::TensorOptions& options) {
  SceneLatents result = latents;
  for (torch::Tensor* tensor : tensors_of(result)) {
    if (tensor->defined()) *tensor = tensor->to(options);
  }
  return result;
}

int64_t bytes_of(SceneLatents latents) {
  int64_t bytes = 0;
  for (const torch::Tensor* tensor : tensors_of(latents)) {
    if (tensor->defined()) bytes += tensor->numel() * tensor->element_size();
  }
  return bytes;
}

// Different views of one scene have different cameras, and so have crops of one view.
std::string key_of(const TrainingScene& scene) {
  std::string key = scene.name + '/' + std::to_string(scene.views.num_sources);
  const auto append = [&key](const auto& matrix) {
    key.append(reinterpret_cast<const char*>(matrix.data()),
               sizeof(double) * static_cast<size_t>(matrix.size()));
  };
  for (const Camera& camera : scene.views.cameras) {
    append(Eigen::Matrix4d(camera.world_from_camera.matrix()));
    append(camera.intrinsics);
    key += std::to_string(camera.width) + 'x' + std::to_string(camera.height);
  }
  return key;
}

}  // namespace

SceneLatents SceneLatents::to(torch::Device device) const {
  return converted(*this, torch::TensorOptions().device(device));
}

KeptLatents::KeptLatents(double gib) : most_bytes_(static_cast<int64_t>(gib * (int64_t{1} << 30))) {}

SceneLatents KeptLatents::get(const TrainingScene& scene, const std::function<SceneLatents()>& encode) {
  const auto full = torch::TensorOptions().dtype(torch::kFloat32);
  std::string key = key_of(scene);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto found = kept_.find(key);
    if (found != kept_.end()) return converted(found->second, full);
  }
  const SceneLatents rounded =
      converted(encode(), torch::TensorOptions().dtype(torch::kFloat16).device(torch::kCPU));
  const int64_t bytes = bytes_of(rounded) + static_cast<int64_t>(key.size());
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (bytes_ + bytes <= most_bytes_ && kept_.emplace(std::move(key), rounded).second) bytes_ += bytes;
  }
  return converted(rounded, full);
}

}  // namespace gld
