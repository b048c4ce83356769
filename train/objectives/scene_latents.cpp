#include "train/objectives/scene_latents.h"

#include <array>

namespace gld {
namespace {

struct NamedPart {
  const char* name;
  torch::Tensor* tensor;
};

std::array<NamedPart, 5> parts_of(SceneLatents& latents) {
  DitSceneInputs& shown = latents.shown;
  return {{{"clean", &latents.clean},
           {"source_features", &shown.source_features},
           {"deeper_level", &shown.deeper_level},
           {"warp_agreement", &shown.warp_agreement},
           {"warped_features", &shown.warped_features}}};
}

}  // namespace

SceneLatents SceneLatents::to(torch::Device device) const {
  SceneLatents result = *this;
  for (const NamedPart& part : parts_of(result)) {
    if (part.tensor->defined()) *part.tensor = part.tensor->to(device);
  }
  return result;
}

KeptLatents::KeptLatents(double gib) : type_(gib > 0 ? torch::kFloat16 : torch::kFloat32), kept_(gib) {}

SceneLatents KeptLatents::get(const TrainingScene& scene, const std::function<SceneLatents()>& encode) {
  const KeptTensors kept = kept_.get(scene, type_ == torch::kFloat16 ? "latents" : "whole latents", [&] {
    SceneLatents latents = encode();
    KeptTensors tensors;
    for (const NamedPart& part : parts_of(latents)) {
      if (part.tensor->defined()) tensors[part.name] = part.tensor->to(torch::kCPU, type_);
    }
    return tensors;
  });
  SceneLatents latents;
  latents.shown.views = scene.views;
  for (const NamedPart& part : parts_of(latents)) {
    const auto found = kept.find(part.name);
    if (found != kept.end()) *part.tensor = found->second.to(torch::kFloat32);
  }
  return latents;
}

}  // namespace gld
