#pragma once

#include "gld/splatting/gaussian_set.h"

#include <cstdint>

namespace gld {

constexpr int64_t kMostHarmonicCoefficients = harmonic_coefficients(kMostHarmonicDegree);

// Computes the real spherical harmonics of a direction of length 1, in 3DGS's order and signs: by degree, m from -l to
// l, with the Condon-Shortley phase. values are (harmonic_coefficients(degree)), set.
void spherical_harmonics(int64_t degree, const double direction[3], double* values);

// Computes d values / d direction, (coefficients, 3), of the polynomials as they are written: the direction's length is
// not held at 1.
void spherical_harmonic_slopes(int64_t degree, const double direction[3], double (*slopes)[3]);

// 3DGS adds this to the sum of coefficients and harmonics: a coefficient of 0 is grey.
constexpr double kHarmonicGrey = 0.5;

// Returns the coefficient 0 of a colour from 0 to 1 that is the same from everywhere.
double coefficient_of_colour(double colour);
double colour_of_coefficient(double coefficient);

}  // namespace gld
