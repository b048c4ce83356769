#pragma once

#include "models/bundle/bundle.h"

#include <cstdint>
#include <optional>
#include <vector>

namespace gld {

// How far single scenes of the training data are from the statistics over all of them, by the latents of one level
// (gld/latents/latent_divergence.h): what is usual for the model.
struct SeenLevel {
  int64_t level = 0;
  double median = 0;
  double usual = 0;  // 99 of 100 scenes are nearer
  double largest = 0;
};

// What a model was trained on, as gld stats notes it beside the statistics: seen_scenes.json in the bundle's folder. It
// is no part of the bundle's weights, nor of its content hash.
struct SeenScenes {
  bool drawn = false;  // by gld synth: no photograph was among them
  int64_t scenes = 0;  // that the divergences are of
  std::vector<SeenLevel> levels;
};

constexpr const char* kSeenScenesFile = "seen_scenes.json";

// divergences has one a scene, in any order; at least one.
SeenLevel seen_level(int64_t level, std::vector<double> divergences);

// Writes it beside the bundle's statistics, whose files it names by their SHA-256.
void write_seen_scenes(const ModelBundle& bundle, const SeenScenes& seen);

// Returns nothing where the bundle has no such file, as published ones, or one of other statistics. Throws Error,
// naming the file, for a damaged one.
std::optional<SeenScenes> read_seen_scenes(const ModelBundle& bundle);

}  // namespace gld
