#include "datasets/synthetic/synthetic_material.h"

#include "datasets/synthetic/photographic_material.h"
#include "datasets/synthetic/surface_noise.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

using Eigen::Vector3d;

// Returns a square wave of period 2 in [-1, 1], averaged over width (its integral is a triangle wave).
double square_wave(double x, double width) {
  const double w = std::max(width, 1e-4);
  const double right = std::abs(fraction((x + 0.5 * w) / 2) - 0.5);
  const double left = std::abs(fraction((x - 0.5 * w) / 2) - 0.5);
  return 2 * (left - right) / w;
}

// Returns 1 on the joints of a unit lattice, 0 inside the cells; joints narrower than the footprint fade to their
// share.
double joint(double x, double half_width, double footprint) {
  const double distance = 0.5 - std::abs(fraction(x) - 0.5);
  const double blur = std::max(footprint, 0.02);
  const double sharp = 1 - smooth_step(half_width - 0.5 * blur, half_width + 0.5 * blur, distance);
  return mixed(Vector3d::Constant(sharp), Vector3d::Constant(2 * half_width),
               smooth_step(0.3, 0.9, footprint))
      .x();
}

Vector3d bricks(const Material& m, double u, double v, double footprint, double aspect) {
  const double row = v * aspect;
  const auto row_index = static_cast<int64_t>(std::floor(row));
  const double shift = aspect > 1 && (row_index & 1) != 0 ? 0.5 : 0.0;
  const double column = u + shift;
  const auto column_index = static_cast<int64_t>(std::floor(column));
  const double tint = 0.82 + 0.36 * cell_value(column_index, row_index, m.seed);
  const double fade = smooth_step(0.5, 1.0, footprint * aspect);
  const Vector3d face = m.first * (tint * (1 - fade) + fade);
  const double joints =
      std::max(joint(column, 0.03, footprint), joint(row, 0.03 * aspect, footprint * aspect));
  return mixed(face, m.second, std::clamp(joints, 0.0, 1.0));
}

Vector3d wood(const Material& m, double u, double v, double footprint) {
  const auto plank = static_cast<int64_t>(std::floor(v));
  const double tint = 0.85 + 0.3 * cell_value(plank, 7, m.seed);
  const double grain =
      layered_noise(0.6 * u + 13.7 * static_cast<double>(plank), 5 * v, m.seed, 3 * footprint);
  const Vector3d face = mixed(m.first, m.second, grain) * tint;
  return face * (1 - 0.55 * joint(v, 0.035, footprint));
}

// Draws a landscape: sky, sun and two rows of hills.
Vector3d painting(const Material& m, double u, double v) {
  if (u < 0.06 || u > 0.94 || v < 0.06 || v > 0.94) return Vector3d(0.08, 0.05, 0.03);
  const double tilt = static_cast<double>(m.seed % 97) / 97.0;
  Vector3d colour = mixed(m.second, Vector3d(0.9, 0.9, 0.85), 0.8 * v);
  const double sun = std::hypot(u - 0.25 - 0.5 * tilt, v - 0.68);
  colour = mixed(Vector3d(1.0, 0.75, 0.2), colour, smooth_step(0.09, 0.12, sun));
  const double far_hills = 0.42 + 0.10 * std::sin(9 * u + 20 * tilt);
  const double near_hills = 0.24 + 0.08 * std::sin(6 * u + 50 * tilt);
  if (v < far_hills) colour = mixed(m.first, m.second, 0.35);
  if (v < near_hills) colour = 0.6 * m.first;
  return colour;
}

// Here and in synthetic_layout.cpp several draws of one call are drawn from the last to the first: as g++ evaluated its
// arguments, and so as in every scene that was drawn before this order was written down.
Vector3d draw_shade(SeededRandom& random, double hue, const DrawRange& saturation, const DrawRange& value) {
  const double v = value.draw(random), s = saturation.draw(random);
  return colour_from_hsv(hue, s, v);
}

// Returns the colour without stains.
Vector3d clean_albedo(const Material& m, double surface_u, double surface_v, double surface_footprint) {
  if (m.pattern == Pattern::kPlain) return m.first;
  if (m.pattern == Pattern::kPainting) return painting(m, surface_u, surface_v);
  if (m.pattern == Pattern::kCollage) return photographic_pattern(m, surface_u, surface_v, 0);
  const double cosine = std::cos(m.angle);
  const double sine = std::sin(m.angle);
  const double u = (cosine * surface_u - sine * surface_v) / m.period;
  const double v = (sine * surface_u + cosine * surface_v) / m.period;
  const double footprint = surface_footprint / m.period;
  switch (m.pattern) {
    case Pattern::kChecker:
      return mixed(m.first, m.second,
                   0.5 - 0.5 * square_wave(2 * u, 2 * footprint) * square_wave(2 * v, 2 * footprint));
    case Pattern::kStripes:
      return mixed(m.first, m.second, 0.5 - 0.5 * square_wave(2 * u, 2 * footprint));
    case Pattern::kBricks:
      return bricks(m, u, v, footprint, 2);
    case Pattern::kTiles:
      return bricks(m, u, v, footprint, 1);
    case Pattern::kDots: {
      const double distance = std::hypot(fraction(u) - 0.5, fraction(v) - 0.5);
      const double blur = std::max(footprint, 0.03);
      const double inside = 1 - smooth_step(0.28 - 0.5 * blur, 0.28 + 0.5 * blur, distance);
      const double share = 3.14159 * 0.28 * 0.28;
      const double fade = smooth_step(0.4, 1.0, footprint);
      return mixed(m.first, m.second, inside * (1 - fade) + share * fade);
    }
    case Pattern::kMarble: {
      const double bend = 1.5 * layered_noise(u, v, m.seed, footprint);
      const double vein = 0.5 + 0.5 * std::sin(6.2832 * (0.7 * u + 0.4 * v + bend));
      return mixed(m.first, m.second, vein * vein * (1 - smooth_step(0.3, 0.9, footprint)));
    }
    case Pattern::kWood:
      return wood(m, u, v, footprint);
    default:
      return photographic_pattern(m, u, v, footprint);
  }
}

}  // namespace

Vector3d albedo(const Material& m, double u, double v, double footprint) {
  const Vector3d clean = clean_albedo(m, u, v, footprint);
  return m.stains == 0 ? clean : clean * stain(m, u, v, footprint);
}

Vector3d mixed(const Vector3d& a, const Vector3d& b, double t) { return a * (1 - t) + b * t; }

Vector3d colour_from_hsv(double hue, double saturation, double value) {
  Vector3d colour;
  for (int channel = 0; channel < 3; ++channel) {
    const double position = 6 * fraction(hue + (3 - channel) / 3.0);
    const double ramp = std::clamp(std::abs(position - 3) - 1, 0.0, 1.0);
    colour[channel] = std::pow(value * (1 - saturation * (1 - ramp)), 2.2);
  }
  return colour;
}

Vector3d draw_colour(SeededRandom& random, const DrawRange& hue, const DrawRange& saturation,
                     const DrawRange& value) {
  const double v = value.draw(random), s = saturation.draw(random), h = hue.draw(random);
  return colour_from_hsv(h, s, v);
}

Material draw_floor(SeededRandom& random) {
  Material m;
  m.seed = random.bits();
  m.angle = random.chance(0.5) ? 0 : 1.5707963;
  const double kind = random.uniform();
  if (kind < 0.4) {
    m.pattern = Pattern::kWood;
    m.first = draw_colour(random, {0.05, 0.1}, {0.35, 0.6}, {0.6, 0.85});
    m.second = 0.55 * m.first;
    m.period = random.uniform(0.25, 0.45);
  } else if (kind < 0.7) {
    m.pattern = Pattern::kChecker;
    const double hue = random.uniform();
    m.first = draw_shade(random, hue, {0.02, 0.25}, {0.8, 0.95});
    m.second = draw_shade(random, hue, {0.1, 0.5}, {0.3, 0.55});
    m.period = random.uniform(0.9, 1.6);
  } else if (kind < 0.88) {
    m.pattern = Pattern::kTiles;
    m.first = draw_colour(random, {}, {0.05, 0.35}, {0.55, 0.85});
    m.second = 0.45 * m.first;
    m.period = random.uniform(0.5, 0.9);
  } else {
    m.pattern = Pattern::kMarble;
    m.first = draw_colour(random, {}, {0.02, 0.15}, {0.8, 0.95});
    m.second = 0.5 * m.first;
    m.period = random.uniform(0.8, 1.5);
  }
  return m;
}

Material draw_wall(SeededRandom& random, double hue) {
  Material m;
  m.seed = random.bits();
  const double value = random.uniform(0.72, 0.95), saturation = random.uniform(0.08, 0.4);
  m.first = colour_from_hsv(hue + random.uniform(-0.06, 0.06), saturation, value);
  m.second = m.first * random.uniform(0.6, 0.8);
  m.period = random.uniform(0.5, 1.1);
  const double kind = random.uniform();
  if (kind < 0.3) {
    m.pattern = Pattern::kPlain;
  } else if (kind < 0.55) {
    m.pattern = Pattern::kStripes;
  } else if (kind < 0.75) {
    m.pattern = Pattern::kBricks;
    m.first = draw_colour(random, {0.0, 0.08}, {0.3, 0.55}, {0.55, 0.8});
    m.second = Vector3d::Constant(0.55);
    m.period = random.uniform(0.45, 0.7);
  } else if (kind < 0.88) {
    m.pattern = Pattern::kDots;
  } else {
    m.pattern = Pattern::kMarble;
    m.second = 0.75 * m.first;
    m.period = random.uniform(1.0, 2.0);
  }
  return m;
}

Material draw_object(SeededRandom& random) {
  Material m;
  m.seed = random.bits();
  const double hue = random.uniform();
  m.first = draw_shade(random, hue, {0.55, 0.9}, {0.6, 0.95});
  m.second = {0.85, 0.84, 0.8};
  if (random.chance(0.5)) {
    const double saturation = random.uniform(0.4, 0.8);
    m.second = colour_from_hsv(hue + random.uniform(0.3, 0.7), saturation, 0.85);
  }
  m.period = random.uniform(0.25, 0.5);
  m.angle = random.chance(0.5) ? 0 : random.uniform(0, 3.1415926);
  const Pattern patterns[] = {Pattern::kPlain,   Pattern::kPlain, Pattern::kPlain,  Pattern::kChecker,
                              Pattern::kStripes, Pattern::kDots,  Pattern::kMarble, Pattern::kWood};
  m.pattern = patterns[random.integer(0, 7)];
  if (m.pattern == Pattern::kWood) {
    m.first = draw_colour(random, {0.05, 0.1}, {0.4, 0.6}, {0.55, 0.85});
    m.second = 0.55 * m.first;
    m.angle = 0;
  }
  return m;
}

Material draw_painting(SeededRandom& random) {
  Material m;
  m.pattern = Pattern::kPainting;
  m.seed = random.bits();
  const double hue = random.uniform();
  m.first = colour_from_hsv(hue, 0.6, 0.55);
  m.second = colour_from_hsv(hue + random.uniform(0.25, 0.5), 0.55, 0.85);
  return m;
}

}  // namespace gld
