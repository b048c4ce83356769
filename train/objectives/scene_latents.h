#pragma once

#include "models/dit/dit_scene.h"
#include "train/data/training_scene.h"
#include "train/objectives/kept_scenes.h"

#include <functional>

#include <torch/types.h>

namespace gld {

// What the frozen backbone makes of a scene for flow matching.
struct SceneLatents {
  DitSceneInputs shown;  // to the model
  torch::Tensor
      clean;  // what it has to generate: all views encoded together, (views, tokens, channels), normalised

  SceneLatents to(torch::Device device) const;
};

// Keeps the latents of scenes for the next time they are trained on: encoding them costs as much as a training step
// of a small model. In memory they are kept in float16, and the first use gets the rounded ones as well, so that a run
// does not depend on what an earlier process has kept. Where none are kept in memory, a folder has them as they are: it
// changes nothing either.
class KeptLatents {
 public:
  // gib bounds their memory; past it scenes are encoded every time. 0 keeps none.
  explicit KeptLatents(double gib);

  void keep_in(std::shared_ptr<const KeptFolder> folder) { kept_.keep_in(std::move(folder)); }
  bool enabled() const { return kept_.enabled(); }
  // Returns the latents of that scene (its name and cameras tell), on the CPU and in float32; encode makes them where
  // they are not kept. It may be called from several threads.
  SceneLatents get(const TrainingScene& scene, const std::function<SceneLatents()>& encode);

 private:
  torch::Dtype type_;
  KeptScenes kept_;
};

}  // namespace gld
