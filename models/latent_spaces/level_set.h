#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace gld {

// A part of a model that generates one level: M_l from noise and the source features, or a cascade m -> l, which is
// also given the deeper level m. The published model is {M_1, cascade 1 -> 0}.
struct LevelGenerator {
  int64_t level = 0;
  std::optional<int64_t> deeper;  // a cascade's

  bool is_cascade() const { return deeper.has_value(); }
  bool operator==(const LevelGenerator& other) const {
    return level == other.level && deeper == other.deeper;
  }
};

LevelGenerator level_model(int64_t level);
LevelGenerator cascade(int64_t deeper, int64_t level);

// Returns it as model.yaml lists it: "1", "1->0".
std::string generator_text(const LevelGenerator& generator);
// Reads it from such text; throws Error naming where otherwise.
LevelGenerator generator_from_text(const std::string& text, const std::string& where);
// Returns the name of its file, its options and the field of its time shift: "level1"; "cascade" for 1 -> 0,
// "cascade_2_to_1" for others.
std::string generator_name(const LevelGenerator& generator);
// Returns its name for people and reports: "M1"; "cascade" for 1 -> 0, "cascade 2->1" for others.
std::string generator_stage(const LevelGenerator& generator);
// Returns the stream that the noise of a level is drawn from (gld/latents/noise.h).
std::string level_noise_stream(int64_t level);

// Which levels a model generates, and how the others come about: shallower ones than the boundary level must be
// generated where decoders take them, deeper ones come by propagation from it.
struct LevelSet {
  std::vector<LevelGenerator> generators;  // in the order of sampling
  int64_t boundary = 1;
  int64_t levels = 4;            // of the backbone
  std::vector<int64_t> decoded;  // that the RGB decoder takes; all when empty
  // Photographs that the generators want carried into each target view by the depth of the source views; each takes the
  // first so many of them that it has room for.
  int64_t warped_sources = 0;

  bool generates(int64_t level) const;
  // Returns whether sampling knows that level at the end, generated or propagated.
  bool knows(int64_t level) const { return level >= boundary || generates(level); }
  // Returns the levels that decoders take, ascending.
  std::vector<int64_t> decoded_levels() const;
  // Returns the deepest level that source views have to be encoded to.
  int64_t deepest_generated() const;
};

// Throws Error with the reason where the set cannot be sampled: no part generates the boundary level, a level is
// generated twice or behind the boundary, a cascade comes before its deeper level, or a decoded level is not known.
void check_level_set(const LevelSet& set);

}  // namespace gld
