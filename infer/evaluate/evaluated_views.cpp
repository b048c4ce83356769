#include "infer/evaluate/evaluated_views.h"

#include "gld/base/error.h"
#include "infer/request/held_out_scenes.h"

#include <algorithm>
#include <cstddef>
#include <set>
#include <string>
#include <utility>

namespace gld {
namespace {

void check_frames(const std::vector<int64_t>& frames, const char* flag, const Scene& scene) {
  const auto last = static_cast<int64_t>(scene.frames.size()) - 1;
  for (const int64_t frame : frames) {
    if (frame <= last) continue;
    fail({flag, "frames from 0 to " + std::to_string(last) + ", which scene '" + scene.name + "' has",
          std::to_string(frame), "choose among its frames, or leave the scene out"});
  }
}

// Returns `count` of the frames, spread evenly from the first to the last.
std::vector<int64_t> spread(const std::vector<int64_t>& frames, int64_t count) {
  const auto last = static_cast<int64_t>(frames.size()) - 1;
  std::vector<int64_t> chosen;
  for (int64_t i = 0; i < count; ++i) {
    // Rounded to the nearest.
    const int64_t place = count == 1 ? 0 : (2 * i * last + count - 1) / (2 * (count - 1));
    chosen.push_back(frames[static_cast<size_t>(place)]);
  }
  return chosen;
}

int64_t most_sources(const EvaluatedViews& views) {
  return views.source_counts.empty()
             ? views.sampling.most_sources
             : *std::max_element(views.source_counts.begin(), views.source_counts.end());
}

}  // namespace

void check_evaluated_views(const EvaluatedViews& views) {
  if (views.source_frames.empty() != views.target_frames.empty()) {
    fail({"--source-frames, --target-frames", "both, or neither",
          views.source_frames.empty() ? "only targets" : "only sources", "give both"});
  }
  for (const int64_t count : views.source_counts) {
    if (count >= 1) continue;
    fail({"--source-counts", "numbers from 1", std::to_string(count), "leave it out"});
  }
  const std::set<int64_t> different(views.source_counts.begin(), views.source_counts.end());
  if (different.size() < views.source_counts.size()) {
    fail({"--source-counts", "different numbers", "one of them twice", "leave out all but one"});
  }
  const int64_t most = most_sources(views);
  if (!views.source_frames.empty()) {
    if (views.source_counts.empty() || most <= static_cast<int64_t>(views.source_frames.size())) return;
    fail({"--source-counts",
          "at most " + std::to_string(views.source_frames.size()) + ", the --source-frames",
          std::to_string(most), "give more frames or fewer sources"});
  }
  if (most >= views.sampling.views) {
    fail({views.source_counts.empty() ? "views.most_sources" : "--source-counts", "fewer sources than views",
          std::to_string(most), "leave at least one target"});
  }
}

std::vector<ViewSelection> evaluated_views(const EvaluatedViews& views, const Scene& scene,
                                           const SampleKey& key) {
  std::vector<int64_t> sources = views.source_frames, targets = views.target_frames;
  check_frames(sources, "--source-frames", scene);
  check_frames(targets, "--target-frames", scene);
  if (sources.empty()) {
    ViewSampling sampling = views.sampling;
    if (!views.source_counts.empty()) sampling.fewest_sources = sampling.most_sources = most_sources(views);
    const SampledViews chosen = held_out_sample(scene, sampling, key);
    const auto first_target = chosen.frames.begin() + static_cast<std::ptrdiff_t>(chosen.num_sources);
    sources.assign(chosen.frames.begin(), first_target);
    targets.assign(first_target, chosen.frames.end());
  }
  std::vector<int64_t> counts = views.source_counts;
  if (counts.empty()) counts.push_back(static_cast<int64_t>(sources.size()));
  std::vector<ViewSelection> selections;
  for (const int64_t count : counts) {
    const auto chosen = spread(sources, count);
    ViewSelection selection;
    selection.sources.assign(chosen.begin(), chosen.end());
    selection.targets.assign(targets.begin(), targets.end());
    selections.push_back(std::move(selection));
  }
  return selections;
}

}  // namespace gld
