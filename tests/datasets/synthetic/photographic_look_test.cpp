#include "datasets/synthetic/photographic_look.h"

#include <cmath>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Dark on the left, light on the right.
Image halves() {
  Image image(32, 24);
  for (int64_t y = 0; y < image.height; ++y) {
    for (int64_t x = 0; x < image.width; ++x) {
      for (int channel = 0; channel < 3; ++channel) image.pixel(x, y)[channel] = x < 16 ? 40 : 180;
    }
  }
  return image;
}

double mean_of(const Image& image) {
  double sum = 0;
  for (const uint8_t value : image.rgb) sum += value;
  return sum / static_cast<double>(image.rgb.size());
}

TEST(PhotographicLook, AFaultlessCameraChangesNothingButWhatIsNearlyWhite) {
  const Image picture = halves();
  EXPECT_EQ(photographed(picture, {}, 3).rgb, picture.rgb);
}

TEST(PhotographicLook, BlurSpreadsAnEdgeAndKeepsTheLight) {
  PhotographicLook look;
  look.blur = 0.6;
  const Image blurred = photographed(halves(), look, 0);
  // Half of .36 is what either neighbour gives.
  EXPECT_EQ(blurred.pixel(16, 10)[0], std::lround(180 - 0.18 * 140));
  EXPECT_EQ(blurred.pixel(15, 10)[0], std::lround(40 + 0.18 * 140));
  EXPECT_EQ(blurred.pixel(2, 2)[1], 40);
  EXPECT_NEAR(mean_of(blurred), 110, 0.1);
}

TEST(PhotographicLook, CornersAreDarkerByTheVignetting) {
  PhotographicLook look;
  look.vignetting = 0.3;
  const Image picture = halves(), taken = photographed(picture, look, 0);
  const double across = 31.0 / 32, along = 23.0 / 24;  // of the corner pixel, from the middle
  EXPECT_NEAR(taken.pixel(31, 0)[2], (1 - 0.15 * (across * across + along * along)) * 180, 1);
  EXPECT_NEAR(taken.pixel(16, 12)[2], 180, 1);
}

TEST(PhotographicLook, ExposureAndNoiseAreOfTheFrame) {
  PhotographicLook look;
  look.exposure_spread = 0.1;
  look.seed = 4;
  const Image picture = halves();
  double sum = 0, squares = 0;
  constexpr int kFrames = 200;
  for (int64_t frame = 0; frame < kFrames; ++frame) {
    const double exposure = std::log(photographed(picture, look, frame).pixel(0, 0)[0] / 40.0);
    sum += exposure;
    squares += exposure * exposure;
  }
  const double mean = sum / kFrames;
  EXPECT_NEAR(mean, 0, 0.03);
  EXPECT_NEAR(std::sqrt(squares / kFrames - mean * mean), 0.1, 0.02);
  EXPECT_EQ(photographed(picture, look, 5).rgb, photographed(picture, look, 5).rgb);

  look.exposure_spread = 0;
  look.noise = 0.02;
  const Image noisy = photographed(picture, look, 1);
  EXPECT_NE(noisy.rgb, photographed(picture, look, 2).rgb);
  double variance = 0;
  for (size_t i = 0; i < noisy.rgb.size(); ++i) variance += std::pow(noisy.rgb[i] - picture.rgb[i], 2);
  EXPECT_NEAR(std::sqrt(variance / static_cast<double>(noisy.rgb.size())) / 255, 0.02, 0.002);
}

TEST(PhotographicLook, BrightLightIsCompressedAndNeverWraps) {
  PhotographicLook look;
  look.balance = {4, 4, 4};
  look.contrast = 1.3;
  const Image taken = photographed(halves(), look, 0);
  EXPECT_GE(taken.pixel(31, 3)[0], 250);
  EXPECT_GT(taken.pixel(31, 3)[0], taken.pixel(0, 3)[0]);
}

}  // namespace
}  // namespace gld
