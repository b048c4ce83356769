#pragma once

#include "gld/cameras/camera.h"
#include "gld/latents/level_statistics.h"
#include "models/conditioning/source_conditioning.h"
#include "models/dit/dit_options.h"
#include "models/dit/dit_scene.h"

#include <cstdint>

#include <torch/types.h>

namespace gld {

// A generator as far as what it is shown depends on it.
struct ConditionedGenerator {
  int64_t level = 0;  // that it generates
  const DitOptions& options;
  const LevelStatistics& statistics;  // of that level
};

// Returns, of a raw level (views, leading + patch tokens, C), what is generated of it: normalised, with as many tokens
// in front as there are statistics of. grid is the one whose tokens a view has.
torch::Tensor latent_of_level(const torch::Tensor& raw_level, const LatentGrid& grid,
                              const LevelStatistics& statistics);

// Returns what a generator is shown of a scene: cameras, its level of the source views, and the photographs that were
// carried into target views, of which it takes the first so many that it has room for (zeros where none were). A
// cascade needs its deeper level beside this.
DitSceneInputs condition_on_source_level(const ConditionedGenerator& generator, const Views& views,
                                         const SourceConditioning& sources);

// Here a cascade is conditioned on the deeper level it starts from, the published one on level 1: the latent of all
// views, (views, tokens, C), normalised with that level's own statistics. In sampling it is what the level's generator
// has just made, in training what the encoder makes of the true images, made noisy.
void condition_on_deeper_level(DitSceneInputs& inputs, const torch::Tensor& deeper_latent);

// Returns the deeper level as training shows it, as imperfect as sampling will make it: (F + sigma e) / sqrt(1 +
// sigma^2) with standard normal e (docs/DESIGN.md section 4, "Cascade training").
torch::Tensor noisy_deeper_level(const torch::Tensor& deeper_latent, const torch::Tensor& noise,
                                 double sigma);

}  // namespace gld
