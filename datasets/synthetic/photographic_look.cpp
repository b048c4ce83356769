#include "datasets/synthetic/photographic_look.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace gld {
namespace {

// Makes one pass along a line of `count` values `stride` apart, three weights; what lies outside counts as the border.
void blur_line(float* values, int64_t count, int64_t stride, float side) {
  float before = values[0];
  for (int64_t i = 0; i < count; ++i) {
    const float here = values[i * stride];
    const float after = values[std::min(i + 1, count - 1) * stride];
    values[i * stride] = side * before + (1 - 2 * side) * here + side * after;
    before = here;
  }
}

// The draw is near enough to normal: the sum of four even numbers, its spread brought to 1.
double draw_normal(SeededRandom& random) {
  double sum = -2;
  for (int i = 0; i < 4; ++i) sum += random.uniform();
  return sum * 1.7320508;
}

}  // namespace

PhotographicLook draw_photographic_look(SeededRandom& random) {
  PhotographicLook look;
  look.contrast = random.uniform(0.8, 1.35);
  const double warmth = random.uniform(-0.1, 0.1), brightness = random.uniform(0.75, 1.15);
  look.balance = {brightness * (1 + warmth), brightness, brightness * (1 - warmth)};
  look.vignetting = random.chance(0.5) ? random.uniform(0, 0.35) : 0;
  look.blur = random.chance(0.6) ? random.uniform(0, 0.65) : 0;
  look.exposure_spread = random.chance(0.4) ? random.uniform(0, 0.06) : 0;
  look.noise = random.chance(0.6) ? random.uniform(0, 0.015) : 0;
  look.seed = random.bits();
  return look;
}

Image photographed(const Image& picture, const PhotographicLook& look, int64_t frame) {
  SeededRandom random({look.seed, static_cast<uint64_t>(frame)});
  const double exposure = std::exp(look.exposure_spread * draw_normal(random));
  const int64_t width = picture.width, height = picture.height;
  std::vector<float> values(picture.rgb.begin(), picture.rgb.end());
  // The spread of three weights (s, 1 - 2 s, s) is sqrt(2 s) pixels.
  const auto side = static_cast<float>(0.5 * look.blur * look.blur);
  if (side > 0) {
    for (int64_t channel = 0; channel < 3; ++channel) {
      for (int64_t y = 0; y < height; ++y) blur_line(&values[3 * y * width + channel], width, 3, side);
      for (int64_t x = 0; x < width; ++x) blur_line(&values[3 * x + channel], height, 3 * width, side);
    }
  }
  Image taken(width, height);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const double across = 2 * (static_cast<double>(x) + 0.5) / static_cast<double>(width) - 1;
      const double along = 2 * (static_cast<double>(y) + 0.5) / static_cast<double>(height) - 1;
      const double light = exposure * (1 - 0.5 * look.vignetting * (across * across + along * along));
      const auto at = static_cast<size_t>(3 * (y * width + x));
      for (size_t channel = 0; channel < 3; ++channel) {
        constexpr double kMiddle = 0.45;
        double value = look.balance[static_cast<int>(channel)] * light * values[at + channel] / 255;
        value = kMiddle * std::pow(value / kMiddle, look.contrast);
        // What is brighter than nearly white is compressed, not cut.
        if (value > 0.85) value = 1 - 0.15 * std::exp(-(value - 0.85) / 0.15);
        value += look.noise * draw_normal(random);
        taken.rgb[at + channel] = static_cast<uint8_t>(std::lround(255 * std::clamp(value, 0.0, 1.0)));
      }
    }
  }
  return taken;
}

}  // namespace gld
