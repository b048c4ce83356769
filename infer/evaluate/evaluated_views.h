#pragma once

#include "datasets/scenes/scene.h"
#include "datasets/scenes/view_sampling.h"
#include "infer/request/sampling_scene.h"

#include <cstdint>
#include <vector>

namespace gld {

// Which views of each scene an evaluation takes.
struct EvaluatedViews {
  ViewSampling sampling;
  // Given frames, the same in every scene; both or none. Instead of `sampling`.
  std::vector<int64_t> source_frames;
  std::vector<int64_t> target_frames;
  // The scene is evaluated once with each number of sources, the targets being the same in all, so that numbers are
  // compared scene by scene; where this is empty, it is evaluated once, with all sources.
  std::vector<int64_t> source_counts;
};

// Throws Error for counts that the sampling or the given frames have not, or that leave no target.
void check_evaluated_views(const EvaluatedViews& views);

// Returns one selection a number of sources, in the order of source_counts. Fewer sources than there are at most are
// spread evenly over those, the first one always among them: of sources 0, 3, 6, 9 one is 0 and two are 0, 9. Throws
// Error where the scene has too few frames.
std::vector<ViewSelection> evaluated_views(const EvaluatedViews& views, const Scene& scene,
                                           const SampleKey& key);

}  // namespace gld
