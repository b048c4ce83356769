#pragma once

#include "datasets/loading/dataset.h"
#include "datasets/scenes/scene.h"
#include "datasets/scenes/view_sampling.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "infer/request/sampling_scene.h"
#include "models/bundle/bundle_options.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace gld {

// Generated scenes that training does not see: their seed, and the views that gld eval takes of each, four neighbouring
// ones of which the first and the last are sources.
constexpr int64_t kHeldOutSeed = 777000;
ViewSampling held_out_views();

// Returns the scenes below folders, without their broken frames; where there are none, it is `count` scenes of that
// seed from the generator, whose own seed and number do not count.
std::unique_ptr<Dataset> held_out_dataset(const std::vector<std::string>& folders,
                                          const SyntheticOptions& generator, int64_t seed, int64_t count);

// Returns the key of a scene's choice of views: its number in the dataset, under the seed of the scenes.
SampleKey held_out_key(int64_t seed, int64_t index);

// Returns the views that key chooses. Throws Error where the scene has too few frames.
SampledViews held_out_sample(const Scene& scene, const ViewSampling& sampling, const SampleKey& key);

// Loads the selected views at the trained size of the nearest aspect, with the true depth of the sources.
SamplingScene load_selected_views(const Scene& scene, const ViewSelection& selection,
                                  const BundleOptions& bundle);

// Does so for the views that key chooses. Throws Error as held_out_sample does.
SamplingScene load_held_out_scene(const Scene& scene, const ViewSampling& sampling, const SampleKey& key,
                                  const BundleOptions& bundle);

}  // namespace gld
