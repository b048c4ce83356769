#pragma once

#include "datasets/scenes/seeded_random.h"
#include "datasets/synthetic/synthetic_material.h"

#include <Eigen/Core>

namespace gld {

// Surfaces as photographs show them, all drawn: their spectra fall slowly, no two patches of them are alike.

// Returns linear RGB of a pattern from kMottled on at (u, v), in periods; a pixel covers about so much of it. A collage
// is over [0, 1] x [0, 1].
Eigen::Vector3d photographic_pattern(const Material& material, double u, double v, double footprint);

// Returns what stains multiply a surface's colour by at (u, v), in metres: about 1.
double stain(const Material& material, double u, double v, double footprint);

// These draw materials that suit a part of a place.
Material draw_rough_wall(SeededRandom& random);
Material draw_facade(SeededRandom& random);
Material draw_ground(SeededRandom& random);
Material draw_weathered_object(SeededRandom& random);
Material draw_foliage(SeededRandom& random);
Material draw_poster(SeededRandom& random);

}  // namespace gld
