#pragma once

#include "datasets/registration/picture_features.h"

#include <cstddef>
#include <string>
#include <vector>

namespace gld {

// Features of two pictures that one fundamental matrix explains, whatever the lenses.
struct MatchedPair {
  size_t first = 0, second = 0;  // pictures
  int64_t alike = 0;             // features that look alike
  std::vector<FeatureMatch>
      matches;  // of these, those that lie as two views of one rigid scene can; empty where too few do
  // A camera that turned where it stood (or did not move) explains the pair as well, with some lens: the pictures say
  // nothing of how far anything is, and matches is empty.
  bool seen_from_one_place = false;
};

// The fewest matches for which a pair counts: by chance some dozen of a few hundred fit.
constexpr int64_t kFewestMatches = 24;

MatchedPair matched_pair(const std::vector<PictureFeatures>& pictures, size_t first, size_t second);

// Returns the pairs of pictures worth looking at: all of a few; of many, those whose strongest features have most in
// common, at least most_neighbours a picture.
std::vector<std::pair<size_t, size_t>> pairs_to_match(const std::vector<PictureFeatures>& pictures,
                                                      size_t most_neighbours, int threads);

// Sightings of one place, at most one a picture.
struct Sighting {
  size_t picture = 0;
  int32_t feature = 0;
};
using Track = std::vector<Sighting>;

// Returns tracks joined over pairs. A track that would have two places in one picture is mistaken somewhere, and left
// out.
std::vector<Track> joined_tracks(const std::vector<PictureFeatures>& pictures,
                                 const std::vector<MatchedPair>& pairs);

}  // namespace gld
