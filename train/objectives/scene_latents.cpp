#include "train/objectives/scene_latents.h"

#include <array>
#include <memory>

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

}  // namespace

SceneLatents SceneLatents::to(torch::Device device) const {
  return converted(*this, torch::TensorOptions().device(device));
}

KeptLatents::KeptLatents(double gib) : kept_(gib) {}

SceneLatents KeptLatents::get(const TrainingScene& scene, const std::function<SceneLatents()>& encode) {
  const auto made = kept_.get(scene, "latents", [&]() -> KeptScenes::Made {
    auto rounded = std::make_shared<SceneLatents>(
        converted(encode(), torch::TensorOptions().dtype(torch::kFloat16).device(torch::kCPU)));
    return {rounded, bytes_of(*rounded)};
  });
  return converted(*static_cast<const SceneLatents*>(made.get()),
                   torch::TensorOptions().dtype(torch::kFloat32));
}

}  // namespace gld
