#include "gld/metrics/latent_spectrum.h"

#include "tests/support/error_of.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

torch::Tensor noise(int64_t views, int64_t channels, int64_t side) {
  return torch::randn({views, channels, side, side}, at::detail::createCPUGenerator(4),
                      torch::TensorOptions(torch::kFloat64));
}

// |FFT2| of white noise of variance 1 is Rayleigh's, of mean sqrt(pi / 4) side, at every frequency that is complex.
TEST(RingAmplitudes, OfNoiseAreFlat) {
  const auto rings = ring_amplitudes(noise(60, 16, 32), 15);
  ASSERT_EQ(rings.size(0), 16);
  const double expected = std::sqrt(std::acos(-1.0) / 4) * 32;
  for (int64_t ring = 1; ring <= 15; ++ring)
    EXPECT_NEAR(rings[ring].item<double>() / expected, 1, 0.02) << ring;
}

// A Gaussian blur multiplies every frequency by the Gaussian's transform. (A kernel sampled on pixels has another
// one, with what lies beyond the grid's frequencies folded back.)
TEST(RingAmplitudes, OfABlurAreItsTransferFunction) {
  constexpr int64_t kSide = 32;
  constexpr double kDeviation = 0.8;
  const double unit = 2 * std::acos(-1.0) / kSide * kDeviation;
  auto transfer = torch::zeros({kSide, kSide}, torch::kFloat64);
  for (int64_t y = 0; y < kSide; ++y) {
    for (int64_t x = 0; x < kSide; ++x) {
      const double ky = std::min<double>(y, kSide - y), kx = std::min<double>(x, kSide - x);
      transfer[y][x] = std::exp(-(kx * kx + ky * ky) * unit * unit / 2);
    }
  }
  const auto sharp = noise(60, 16, kSide);
  const auto blurred = torch::real(torch::fft_ifft2(torch::fft_fft2(sharp) * transfer));
  const auto ratio = ring_amplitudes(blurred, 15) / ring_amplitudes(sharp, 15);
  for (int64_t ring = 0; ring <= 15; ++ring) {
    // The mean of the Gaussian's transform over the ring's frequencies.
    double sum = 0, count = 0;
    for (int64_t ky = -kSide / 2; ky < kSide / 2; ++ky) {
      for (int64_t kx = -kSide / 2; kx < kSide / 2; ++kx) {
        if (std::lround(std::hypot(kx, ky)) != ring) continue;
        sum += std::exp(-(kx * kx + ky * ky) * unit * unit / 2);
        count += 1;
      }
    }
    EXPECT_NEAR(ratio[ring].item<double>() / (sum / count), 1, 0.02) << ring;
  }
  EXPECT_LT(band_ratio(ring_amplitudes(blurred, 15), ring_amplitudes(sharp, 15), 8, 15), 0.4);
}

// What is not periodic leaks over its edges into all rings; the window keeps a slope and a slow wave in the lowest
// ones.
TEST(RingAmplitudes, UnderAWindowEdgesDoNotLeak) {
  constexpr int64_t kSide = 32;
  auto picture = torch::zeros({1, 1, kSide, kSide}, torch::kFloat64);
  for (int64_t x = 0; x < kSide; ++x)
    picture.select(3, x).fill_(3 + 0.05 * static_cast<double>(x) + std::sin(0.3 * static_cast<double>(x)));
  const auto plain = ring_amplitudes(picture, 15),
             windowed = ring_amplitudes(picture, 15, SpectrumWindow::kHann);
  for (int64_t ring = 8; ring <= 15; ++ring) {
    EXPECT_GT((plain[ring] / plain[1]).item<double>(), 0.005) << ring;
    EXPECT_LT((windowed[ring] / windowed[1]).item<double>(), 5e-4) << ring;
  }
  EXPECT_EQ(plain[0].item<double>(), windowed[0].item<double>());
  // Noise is as flat as without it, above the lowest rings, into which the mean that was taken away leaks no more.
  const auto rings = ring_amplitudes(noise(60, 16, kSide), 15, SpectrumWindow::kHann);
  const double expected = std::sqrt(std::acos(-1.0) / 4) * kSide;
  for (int64_t ring = 3; ring <= 15; ++ring)
    EXPECT_NEAR(rings[ring].item<double>() / expected, 1, 0.02) << ring;
}

TEST(RingAmplitudes, OfAWaveAreInItsRing) {
  auto picture = torch::zeros({1, 1, 16, 16}, torch::kFloat32);
  for (int64_t x = 0; x < 16; ++x)
    picture.select(3, x).fill_(3 + std::cos(2 * std::acos(-1.0) * 5 * static_cast<double>(x) / 16));
  const auto rings = ring_amplitudes(picture, last_whole_ring(16));
  EXPECT_EQ(rings.size(0), 8);
  EXPECT_EQ(last_whole_ring(64), 31);
  EXPECT_NEAR(rings[0].item<double>(), 3 * 256, 1e-3);
  for (int64_t ring = 1; ring < 8; ++ring) {
    if (ring == 5) {
      EXPECT_GT(rings[ring].item<double>(), 5);
    } else {
      EXPECT_NEAR(rings[ring].item<double>(), 0, 1e-3);
    }
  }
}

TEST(RingAmplitudes, RefusesWhatIsNoSquare) {
  EXPECT_EQ(error_of([] {
              ring_amplitudes(torch::zeros({1, 2, 8, 6}), 3);
            }),
            "spectrum of latents: expected (views, channels, n, n), found (1, 2, 8, 6); cut squares out.");
  EXPECT_EQ(
      error_of([] {
        ring_amplitudes(torch::zeros({1, 2, 8, 8}), 5);
      }),
      "spectrum of latents: expected rings up to 4 of a grid of 8, found 5; ask for fewer, or take larger "
      "latents.");
}

TEST(PrincipalPictures, ShowTheLargestVariationFirst) {
  auto latents = noise(2, 5, 12) * 0.01;
  latents.select(1, 3) *= 500;
  const auto pictures = principal_pictures(latents, latents);
  EXPECT_EQ(pictures.sizes().vec(), (std::vector<int64_t>{2, 3, 12, 12}));
  // Channel 3 is the first direction: its pictures rise with it.
  const auto first = pictures.select(1, 0).to(torch::kFloat64), channel = latents.select(1, 3);
  const auto deviation = channel.std(/*unbiased=*/false).item<double>();
  const auto expected = ((channel - channel.mean()) / deviation / 5 + 0.5).clamp(0, 1);
  EXPECT_LT((first - expected).abs().max().item<double>(), 1e-3);
  const auto two = principal_pictures(noise(1, 2, 8), noise(1, 2, 8));
  EXPECT_EQ(two.select(1, 2).min().item<float>(), 0.5F);
}

}  // namespace
}  // namespace gld
