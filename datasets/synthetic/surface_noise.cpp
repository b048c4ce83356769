#include "datasets/synthetic/surface_noise.h"

#include "gld/base/mixed_bits.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gld {
namespace {

double value_noise(double x, double y, uint64_t seed) {
  const double floor_x = std::floor(x);
  const double floor_y = std::floor(y);
  const auto ix = static_cast<int64_t>(floor_x);
  const auto iy = static_cast<int64_t>(floor_y);
  const double tx = smooth_step(0, 1, x - floor_x);
  const double ty = smooth_step(0, 1, y - floor_y);
  const double top = cell_value(ix, iy, seed) * (1 - tx) + cell_value(ix + 1, iy, seed) * tx;
  const double bottom = cell_value(ix, iy + 1, seed) * (1 - tx) + cell_value(ix + 1, iy + 1, seed) * tx;
  return top * (1 - ty) + bottom * ty;
}

// Returns how much of a wave of that frequency is left where a pixel covers so much.
double visible_share(double footprint, double frequency) {
  return 1 - smooth_step(0.4, 1.2, footprint * frequency);
}

}  // namespace

double smooth_step(double low, double high, double x) {
  const double t = std::clamp((x - low) / (high - low), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

double fraction(double x) { return x - std::floor(x); }

double cell_value(int64_t x, int64_t y, uint64_t seed) {
  const uint64_t bits =
      mixed_bits(seed ^ mixed_bits(static_cast<uint64_t>(x) ^ mixed_bits(static_cast<uint64_t>(y))));
  return static_cast<double>(bits >> 11) * 0x1.0p-53;
}

double layered_noise(double x, double y, uint64_t seed, double footprint) {
  double sum = 0.5;
  double amplitude = 0.5;
  double frequency = 1;
  for (int octave = 0; octave < 3; ++octave) {
    const double visible = visible_share(footprint, frequency);
    if (visible > 0)
      sum += visible * amplitude * (value_noise(x * frequency, y * frequency, seed + octave) - 0.5);
    amplitude *= 0.5;
    frequency *= 2;
  }
  return sum;
}

double fractal_noise(double x, double y, uint64_t seed, double footprint) {
  // Turned by 37 degrees from octave to octave, so that the lattices do not show.
  constexpr double kCosine = 0.7986355, kSine = 0.6018150;
  constexpr double kUsualSum = 1.05;  // half of the largest: hardly anything lies beyond
  double sum = 0;
  double amplitude = 1;
  double frequency = 1;
  for (uint64_t octave = 0; octave < 6; ++octave) {
    const double visible = visible_share(footprint, frequency);
    if (visible <= 0) break;
    sum += visible * amplitude * (2 * value_noise(x * frequency, y * frequency, seed + octave) - 1);
    const double turned = kCosine * x - kSine * y;
    y = kSine * x + kCosine * y;
    x = turned;
    amplitude *= 0.55;
    frequency *= 2;
  }
  return std::clamp(sum / kUsualSum, -1.0, 1.0);
}

Patch patch_at(double x, double y, uint64_t seed) {
  const auto ix = static_cast<int64_t>(std::floor(x)), iy = static_cast<int64_t>(std::floor(y));
  double nearest = std::numeric_limits<double>::infinity(), second = nearest;
  Patch patch;
  for (int64_t cell_y = iy - 1; cell_y <= iy + 1; ++cell_y) {
    for (int64_t cell_x = ix - 1; cell_x <= ix + 1; ++cell_x) {
      const double dx = static_cast<double>(cell_x) + cell_value(cell_x, cell_y, seed) - x;
      const double dy = static_cast<double>(cell_y) + cell_value(cell_x, cell_y, seed + 1) - y;
      const double distance = std::hypot(dx, dy);
      if (distance < nearest) {
        second = nearest;
        nearest = distance;
        patch.value = cell_value(cell_x, cell_y, seed + 2);
      } else {
        second = std::min(second, distance);
      }
    }
  }
  patch.from_middle = nearest;
  patch.from_edge = 0.5 * (second - nearest);
  return patch;
}

}  // namespace gld
