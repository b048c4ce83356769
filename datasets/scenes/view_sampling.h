#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <optional>
#include <vector>

namespace gld {

enum class SourceChoice {
  kRandom,       // training: a random number of sources, chosen at random among the views
  kInterpolate,  // evaluation: sources spread evenly from the first view to the last, targets between them
  kPrefix,       // evaluation: the first views are the sources
};

// In which order a random choice hands out its sources, and after them its targets. The first view and the last one are
// special (the backbone's reference, the frame of the cameras): a model that only meets them as the earliest source and
// the latest target works for no other order. The release permutes all views.
enum class ViewOrder { kShuffled, kTime };

// Which frames of a video make a training scene (paper A.3): a random start, then independent uniform intervals.
struct ViewSampling : OptionsGroup {
  int64_t views = 8;
  int64_t shortest_interval = 1;  // frames between neighbouring views
  int64_t longest_interval = 20;
  int64_t fewest_sources = 1;
  int64_t most_sources = 4;
  SourceChoice sources = SourceChoice::kRandom;
  ViewOrder order = ViewOrder::kShuffled;  // of random sources; evaluations keep the order of the video

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Everything random in a choice follows from these numbers.
struct SampleKey {
  uint64_t seed = 0;
  uint64_t epoch = 0;
  uint64_t index = 0;
  uint64_t attempt = 0;  // counts up when a choice could not be loaded
};

struct SampledViews {
  std::vector<int64_t> frames;  // sources first; within each part in the sampling's order
  int64_t num_sources = 0;
};

// Returns nothing when the video has fewer frames than views. In a short video the longest interval shrinks so that all
// views fit, as in the published loader. The evaluation modes take most_sources sources.
std::optional<SampledViews> sample_views(const ViewSampling& sampling, int64_t num_frames,
                                         const SampleKey& key);

}  // namespace gld
