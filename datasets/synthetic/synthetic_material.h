#pragma once

#include "datasets/scenes/seeded_random.h"

#include <cstdint>

#include <Eigen/Core>

namespace gld {

enum class Pattern {
  kPlain,
  kChecker,
  kStripes,
  kBricks,
  kTiles,
  kDots,
  kMarble,
  kWood,
  kPainting,
  // Of photographic_material.h.
  kMottled,
  kStone,
  kFoliage,
  kText,
  kFacade,
  kCollage
};

// A procedural texture over surface coordinates in metres (what hangs on a wall: over [0, 1] x [0, 1]).
struct Material {
  Pattern pattern = Pattern::kPlain;
  Eigen::Vector3d first = Eigen::Vector3d::Ones();   // linear RGB in [0, 1]
  Eigen::Vector3d second = Eigen::Vector3d::Zero();  // linear RGB in [0, 1]
  double period = 1;                                 // metres
  double angle = 0;                                  // radians, turns the pattern
  uint64_t seed = 0;                                 // of the irregularities
  double gloss = 0;                                  // strength of the lamps' reflections, 0 is matte
  double stains = 0;  // from 0 to 1: how much darker and lighter patches of it are
};

// Returns linear RGB at (u, v), averaged over about footprint metres so that far patterns fade instead of flickering.
Eigen::Vector3d albedo(const Material& material, double u, double v, double footprint);

// Returns a, and b as far as t of 1.
Eigen::Vector3d mixed(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double t);

// Returns linear RGB from hue in [0, 1), saturation and value in [0, 1] (the latter as seen on a screen).
Eigen::Vector3d colour_from_hsv(double hue, double saturation, double value);

// Returns the same of drawn numbers.
Eigen::Vector3d draw_colour(SeededRandom& random, const DrawRange& hue, const DrawRange& saturation,
                            const DrawRange& value);

// These draw materials that suit a part of a room.
Material draw_floor(SeededRandom& random);
Material draw_wall(SeededRandom& random, double hue);
Material draw_object(SeededRandom& random);
Material draw_painting(SeededRandom& random);

}  // namespace gld
