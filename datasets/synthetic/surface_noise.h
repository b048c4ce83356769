#pragma once

#include <cstdint>

namespace gld {

// Irregularities of surfaces: functions of coordinates on a surface and a seed, the same on every machine. Lengths
// are in the units of the coordinates; the footprint is how much of the surface a pixel covers, and what is finer
// than it fades.

// Returns 0 at low and below, 1 at high and above.
double smooth_step(double low, double high, double x);

// Returns what lies behind the decimal point, also of negative numbers: in [0, 1).
double fraction(double x);

// Returns a value in [0, 1), for a cell of a lattice.
double cell_value(int64_t x, int64_t y, uint64_t seed);

// Returns three octaves about 0.5.
double layered_noise(double x, double y, uint64_t seed, double footprint);

// Returns six octaves about 0, within [-1, 1], whose amplitude falls nearly as their wavelength: the statistics of
// photographs.
double fractal_noise(double x, double y, uint64_t seed, double footprint);

// The patch of an irregular paving with about one patch a unit square: of the points, one a lattice cell, which is the
// nearest.
struct Patch {
  double value = 0;        // of the patch, in [0, 1)
  double from_middle = 0;  // distance from its point
  double from_edge = 0;    // about the distance from the next patch, 0 on the border
};
Patch patch_at(double x, double y, uint64_t seed);

}  // namespace gld
