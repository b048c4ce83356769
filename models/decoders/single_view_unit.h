#pragma once

#include "gld/cameras/camera.h"

#include <memory>
#include <vector>

#include <torch/types.h>

namespace gld {

// How long the unit of a geometry head is where it sees one view alone. Nothing in a single picture's geometry tells it
// (the unit is the mean distance of what is seen), but what is usual does: how large rooms and chairs are, how high a
// camera is held.
struct UnitGuess {
  double metres = 0;
  double log_deviation = 0;  // of the logarithm, one standard deviation
};

// A linear guess of log(metres / unit) from what backbone and head make of the view, by ridge regression (Hoerl and
// Kennard 1970): sum of weights (f - mean) / deviation, and the offset. Beyond what was seen it goes no further.
struct SingleViewUnit {
  torch::Tensor mean, deviation, weights;  // (features), float64
  double offset = 0;
  double least = 0, largest = 0;  // logarithms that were seen
  double log_deviation = 0;       // of a scene from what all others say of it
};

// Returns what the guess is made of beside the camera, float64: the mean of the view's patch tokens of the shallowest
// level (tokens, channels), and the logarithm of the head's depth (height, width) in 8x8 cells.
torch::Tensor look_of_view(const torch::Tensor& patches, const torch::Tensor& depth);

// Returns all of it, (features): that, and the logarithm of the camera's focal length in widths of its picture. A
// narrow view of a small thing looks like a wide one of a large thing.
torch::Tensor single_view_features(const torch::Tensor& look, const Camera& camera);

UnitGuess guessed_unit(const SingleViewUnit& unit, const torch::Tensor& features);

// What a head that guesses its unit has seen of a view.
struct SingleView {
  std::shared_ptr<const SingleViewUnit> unit;
  torch::Tensor look;

  UnitGuess guess(const Camera& camera) const {
    return guessed_unit(*unit, single_view_features(look, camera));
  }
};

// features is (scenes, features), log_units one a scene; there are at least three scenes. The penalty is that among
// powers of ten with which each scene is told best by all others, for which no fit has to be made again (Allen 1974).
SingleViewUnit fit_single_view_unit(const torch::Tensor& features, const std::vector<double>& log_units);

}  // namespace gld
