#include "datasets/scenes/view_sampling.h"

#include "datasets/scenes/seeded_random.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

namespace gld {
namespace {

// Returns positions (among the views) of sources spread evenly from the first to the last.
std::vector<int64_t> spread_positions(int64_t count, int64_t views) {
  std::vector<int64_t> positions;
  for (int64_t i = 0; i < count; ++i) {
    const double step = count > 1 ? static_cast<double>(views - 1) / static_cast<double>(count - 1) : 0;
    positions.push_back(std::llround(step * static_cast<double>(i)));
  }
  return positions;
}

std::vector<int64_t> random_positions(SeededRandom& random, int64_t count, int64_t views) {
  std::vector<int64_t> all(static_cast<size_t>(views));
  for (int64_t i = 0; i < views; ++i) all[static_cast<size_t>(i)] = i;
  for (int64_t i = 0; i < count; ++i) {
    std::swap(all[static_cast<size_t>(i)], all[static_cast<size_t>(random.integer(i, views - 1))]);
  }
  all.resize(static_cast<size_t>(count));
  std::sort(all.begin(), all.end());
  return all;
}

void shuffle(SeededRandom& random, std::vector<int64_t>& frames, size_t first, size_t end) {
  for (size_t i = first; i + 1 < end; ++i) {
    const auto other = random.integer(static_cast<int64_t>(i), static_cast<int64_t>(end) - 1);
    std::swap(frames[i], frames[static_cast<size_t>(other)]);
  }
}

SampledViews arranged(const std::vector<int64_t>& frames, const std::vector<int64_t>& sources) {
  SampledViews views;
  std::vector<bool> is_source(frames.size(), false);
  for (int64_t position : sources) {
    is_source[static_cast<size_t>(position)] = true;
    views.frames.push_back(frames[static_cast<size_t>(position)]);
  }
  views.num_sources = static_cast<int64_t>(sources.size());
  for (size_t i = 0; i < frames.size(); ++i) {
    if (!is_source[i]) views.frames.push_back(frames[i]);
  }
  return views;
}

std::vector<int64_t> evaluation_sources(const ViewSampling& sampling) {
  if (sampling.sources == SourceChoice::kInterpolate)
    return spread_positions(sampling.most_sources, sampling.views);
  std::vector<int64_t> positions;
  for (int64_t i = 0; i < sampling.most_sources; ++i) positions.push_back(i);
  return positions;
}

}  // namespace

void ViewSampling::visit(FieldVisitor& visitor) {
  visitor.integer({"views", "views of a scene, sources and targets"}, views, {2, 1000});
  visitor.integer({"shortest_interval", "frames between neighbouring views, at least"}, shortest_interval,
                  {1, 1'000'000});
  visitor.integer({"longest_interval", "frames between neighbouring views, at most"}, longest_interval,
                  {1, 1'000'000});
  visitor.integer({"fewest_sources", "source views, at least"}, fewest_sources, {1, 999});
  visitor.integer({"most_sources", "source views, at most; the evaluation modes take this many"},
                  most_sources, {1, 999});
  visit_choice(visitor,
               {"source_choice",
                "how source views are chosen: at random, spread evenly with the targets between, or the "
                "first ones"},
               sources, {"random", "interpolate", "prefix"});
  visit_choice(visitor,
               {"order", "of random sources, and of the targets behind them: shuffled, or that of the video"},
               order, {"shuffled", "time"});
}

void ViewSampling::check() const {
  if (longest_interval < shortest_interval) {
    fail({"longest_interval", "at least shortest_interval (" + std::to_string(shortest_interval) + ")",
          std::to_string(longest_interval), "raise it"});
  }
  if (most_sources < fewest_sources) {
    fail({"most_sources", "at least fewest_sources (" + std::to_string(fewest_sources) + ")",
          std::to_string(most_sources), "raise it"});
  }
  if (most_sources >= views) {
    fail({"most_sources", "fewer than views (" + std::to_string(views) + ")", std::to_string(most_sources),
          "leave at least one target"});
  }
}

std::optional<SampledViews> sample_views(const ViewSampling& sampling, int64_t num_frames,
                                         const SampleKey& key) {
  sampling.check();
  if (num_frames < sampling.views) return std::nullopt;
  SeededRandom random({key.seed, key.epoch, key.index, key.attempt, 3});
  const int64_t gaps = sampling.views - 1;
  const int64_t longest = std::min(sampling.longest_interval, (num_frames - 1) / gaps);
  const int64_t shortest = std::min(sampling.shortest_interval, longest);
  std::vector<int64_t> frames{0};
  for (int64_t i = 0; i < gaps; ++i) frames.push_back(frames.back() + random.integer(shortest, longest));
  const int64_t start = random.integer(0, num_frames - 1 - frames.back());
  for (int64_t& frame : frames) frame += start;
  if (sampling.sources != SourceChoice::kRandom) return arranged(frames, evaluation_sources(sampling));
  const int64_t count = random.integer(sampling.fewest_sources, sampling.most_sources);
  SampledViews sampled = arranged(frames, random_positions(random, count, sampling.views));
  if (sampling.order == ViewOrder::kShuffled) {
    const auto sources = static_cast<size_t>(sampled.num_sources);
    shuffle(random, sampled.frames, 0, sources);
    shuffle(random, sampled.frames, sources, sampled.frames.size());
  }
  return sampled;
}

}  // namespace gld
