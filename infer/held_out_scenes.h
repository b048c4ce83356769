#pragma once

#include "datasets/scene.h"
#include "datasets/view_sampling.h"
#include "infer/sampling_scene.h"
#include "models/bundle_options.h"

#include <cstdint>

namespace gld {

// Generated scenes that training does not see: their seed, and the views that gld eval takes of each, four neighbouring
// ones of which the first and the last are sources.
constexpr int64_t kHeldOutSeed = 777000;
ViewSampling held_out_views();

// The views that seed and index choose, at the trained size of the nearest aspect. Throws Error where the scene has too
// few frames.
SamplingScene load_held_out_scene(const Scene& scene, const ViewSampling& sampling, const SampleKey& key,
                                  const BundleOptions& bundle);

}  // namespace gld
