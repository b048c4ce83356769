#include "datasets/synthetic/photographic_material.h"

#include "datasets/synthetic/surface_noise.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace gld {
namespace {

using Eigen::Vector3d;

Vector3d mottled(const Material& m, double u, double v, double footprint) {
  const double noise = fractal_noise(u, v, m.seed, footprint);
  // A second noise moves the hue a little: no surface has two colours only.
  const double other = fractal_noise(1.7 * u + 31, 1.7 * v, m.seed + 17, 1.7 * footprint);
  return mixed(m.first, m.second, 0.5 + 0.5 * noise)
      .cwiseProduct(Vector3d(1 + 0.12 * other, 1, 1 - 0.12 * other));
}

// Draws irregular stones with joints.
Vector3d stone(const Material& m, double u, double v, double footprint) {
  const Patch patch = patch_at(u, v, m.seed);
  const double fade = smooth_step(0.4, 1.0, footprint);
  const double tint = (0.6 + 0.7 * patch.value) * (1 - fade) + 0.95 * fade;
  const double grain = 1 + 0.35 * fractal_noise(3 * u, 3 * v, m.seed + 5, 3 * footprint);
  const double joint = 1 - smooth_step(0.03, 0.09 + footprint, patch.from_edge);
  return mixed(m.first * (tint * grain), m.second, joint * (1 - fade));
}

// Draws leaves over leaves with dark gaps between them.
Vector3d foliage(const Material& m, double u, double v, double footprint) {
  const Patch large = patch_at(u, v, m.seed), small = patch_at(2.3 * u, 2.3 * v, m.seed + 9);
  const bool above = large.from_middle < 0.25 + 0.2 * large.value;
  const Patch& leaf = above ? large : small;
  const double light = std::clamp(1.1 - 1.1 * leaf.from_middle, 0.1, 1.0) * (0.35 + 0.9 * leaf.value);
  const double fade = smooth_step(0.4, 1.0, footprint);
  return mixed(m.second, m.first, leaf.value) * (light * (1 - fade) + 0.5 * fade);
}

// Draws lines of words that nobody can read.
Vector3d text(const Material& m, double u, double v, double footprint) {
  constexpr double kInk = 0.21;  // the share of it that a line takes, for lines too fine to see
  const auto line = static_cast<int64_t>(std::floor(v));
  const double height = fraction(v);
  double ink = 0;
  if (height > 0.2 && height < 0.8) {
    const double along = 2.6 * u;
    const auto letter = static_cast<int64_t>(std::floor(along));
    const auto column = static_cast<int64_t>(4 * fraction(along));
    const auto row = static_cast<int64_t>((height - 0.2) / 0.12);
    const bool gap = cell_value(letter, line, m.seed) > 0.82 || column == 3;
    const bool heading = cell_value(line, 0, m.seed + 3) > 0.85;
    if (!gap) ink = cell_value(8 * letter + column, 8 * line + row, m.seed + 1) > (heading ? 0.25 : 0.45);
  }
  const double fade = smooth_step(0.1, 0.35, footprint);
  return mixed(m.first, m.second, ink * (1 - fade) + kInk * fade);
}

// Draws a wall of plaster with a lattice of windows, each another.
Vector3d facade(const Material& m, double u, double v, double footprint) {
  const auto column = static_cast<int64_t>(std::floor(u)), row = static_cast<int64_t>(std::floor(v));
  const double x = std::abs(fraction(u) - 0.5), y = std::abs(fraction(v) - 0.5);
  const double grain = 1 + 0.3 * fractal_noise(2 * u, 2 * v, m.seed, 2 * footprint);
  const double half_width = 0.22 + 0.08 * cell_value(7, 7, m.seed);
  constexpr double kHalfHeight = 0.34, kFrame = 0.04;
  if (x > half_width || y > kHalfHeight) return m.first * grain;
  const bool frame = x > half_width - kFrame || y > kHalfHeight - kFrame || x < 0.5 * kFrame;
  if (frame) return m.second;
  const double inside = cell_value(column, row, m.seed + 2);
  const double curtain = cell_value(column, row, m.seed + 4);
  const double pane = 0.03 + 0.35 * inside * inside + (y < kHalfHeight * curtain ? 0.08 : 0.0);
  return Vector3d(pane, pane * 1.05, pane * 1.15);
}

// Draws a picture of some light and a few shapes, with grain and a frame of white.
Vector3d collage(const Material& m, double u, double v) {
  if (u < 0.04 || u > 0.96 || v < 0.04 || v > 0.96) return Vector3d::Constant(0.85);
  const auto number = [&](int64_t shape, int64_t which) { return cell_value(shape, which, m.seed); };
  Vector3d colour = mixed(m.first, m.second, v + 0.3 * fractal_noise(2 * u, 2 * v, m.seed, 0));
  for (int64_t shape = 0; shape < 9; ++shape) {
    const double turn = 6.2832 * number(shape, 0);
    const double x = u - number(shape, 1), y = v - number(shape, 2);
    const double along = (std::cos(turn) * x + std::sin(turn) * y) / (0.05 + 0.25 * number(shape, 3));
    const double across = (std::cos(turn) * y - std::sin(turn) * x) / (0.05 + 0.25 * number(shape, 4));
    const bool round = number(shape, 5) < 0.6;
    const bool inside =
        round ? std::hypot(along, across) < 1 : std::max(std::abs(along), std::abs(across)) < 1;
    if (!inside) continue;
    colour = colour_from_hsv(number(shape, 6), 0.8 * number(shape, 7), 0.2 + 0.75 * number(shape, 8)) *
             (1 - 0.35 * along);
  }
  return colour * (1 + 0.25 * fractal_noise(9 * u, 9 * v, m.seed + 1, 0));
}

struct Palette {
  DrawRange hue, saturation, value;
};

Vector3d draw_from(SeededRandom& random, const Palette& palette) {
  return draw_colour(random, palette.hue, palette.saturation, palette.value);
}

// Draws earth, stone, plaster, and now and then a colour.
Palette draw_palette(SeededRandom& random) {
  const double kind = random.uniform();
  if (kind < 0.5) return {{0.04, 0.14}, {0.05, 0.45}, {0.3, 0.9}};
  if (kind < 0.75) return {{0.5, 0.68}, {0.0, 0.25}, {0.25, 0.9}};
  return {{0, 1}, {0.1, 0.7}, {0.25, 0.9}};
}

Material draw_of(SeededRandom& random, Pattern pattern, const DrawRange& period) {
  Material m;
  m.pattern = pattern;
  m.seed = random.bits();
  m.period = period.draw(random);
  m.angle = DrawRange{-3.1415926, 3.1415926}.draw(random);
  m.stains = DrawRange{0.0, 0.8}.draw(random);
  const Palette palette = draw_palette(random);
  m.first = draw_from(random, palette);
  m.second = draw_from(random, palette);
  return m;
}

Material upright(Material m) {
  m.angle = 0;
  return m;
}

}  // namespace

Vector3d photographic_pattern(const Material& m, double u, double v, double footprint) {
  switch (m.pattern) {
    case Pattern::kMottled:
      return mottled(m, u, v, footprint).cwiseMax(0);
    case Pattern::kStone:
      return stone(m, u, v, footprint);
    case Pattern::kFoliage:
      return foliage(m, u, v, footprint);
    case Pattern::kText:
      return text(m, u, v, footprint);
    case Pattern::kFacade:
      return facade(m, u, v, footprint);
    case Pattern::kCollage:
      return collage(m, u, v).cwiseMax(0).cwiseMin(1);
    default:
      return m.first;
  }
}

double stain(const Material& m, double u, double v, double footprint) {
  constexpr double kSize = 0.8;  // metres, of the largest stains
  return 1 + 0.5 * m.stains * fractal_noise(u / kSize, v / kSize, m.seed + 101, footprint / kSize);
}

Material draw_rough_wall(SeededRandom& random) {
  const double kind = random.uniform();
  if (kind < 0.45) return draw_of(random, Pattern::kMottled, {0.3, 2.5});
  if (kind < 0.75) return draw_of(random, Pattern::kStone, {0.15, 0.7});
  if (kind < 0.9) return draw_of(random, Pattern::kMarble, {0.6, 2.0});
  return upright(draw_of(random, Pattern::kBricks, {0.25, 0.6}));
}

Material draw_facade(SeededRandom& random) {
  Material m = upright(draw_of(random, Pattern::kFacade, {0.7, 1.8}));
  m.second = draw_colour(random, {}, {0.05, 0.15}, {0.4, 0.95});
  return m;
}

Material draw_ground(SeededRandom& random) {
  const double kind = random.uniform();
  if (kind < 0.4) return draw_of(random, Pattern::kMottled, {0.4, 2.0});
  if (kind < 0.7) return draw_of(random, Pattern::kStone, {0.1, 0.5});
  if (kind < 0.85) return draw_foliage(random);
  return draw_of(random, Pattern::kTiles, {0.3, 0.8});
}

Material draw_weathered_object(SeededRandom& random) {
  const double kind = random.uniform();
  if (kind < 0.35) return draw_of(random, Pattern::kMottled, {0.1, 0.8});
  if (kind < 0.5) return draw_of(random, Pattern::kStone, {0.06, 0.25});
  if (kind < 0.6) {
    Material m = upright(draw_of(random, Pattern::kText, {0.04, 0.15}));
    m.first = draw_colour(random, {}, {0, 0.3}, {0.7, 1});
    m.second = 0.15 * m.second;
    return m;
  }
  if (kind < 0.7) return draw_of(random, Pattern::kWood, {0.1, 0.4});
  Material m = draw_object(random);
  m.stains = random.uniform(0.1, 1);
  return m;
}

Material draw_foliage(SeededRandom& random) {
  Material m = draw_of(random, Pattern::kFoliage, {0.05, 0.2});
  const Palette leaves = {{0.13, 0.38}, {0.3, 0.7}, {0.3, 0.75}};
  m.first = draw_from(random, leaves);
  m.second = 0.5 * draw_from(random, leaves);
  return m;
}

Material draw_poster(SeededRandom& random) {
  if (random.chance(0.7)) {
    Material m = draw_of(random, Pattern::kCollage, {1, 1});
    m.stains = 0;
    return m;
  }
  Material m = upright(draw_of(random, Pattern::kText, {0.04, 0.12}));
  m.first = draw_colour(random, {}, {0, 0.15}, {0.8, 1});
  m.second = 0.15 * m.second;
  m.stains = 0;
  return m;
}

}  // namespace gld
