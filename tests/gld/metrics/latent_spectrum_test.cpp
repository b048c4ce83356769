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

// Circular convolution multiplies every frequency by the kernel's transform.
TEST(RingAmplitudes, OfABlurAreItsTransferFunction) {
  constexpr int64_t kSide = 32;
  constexpr double kDeviation = 0.8;
  auto kernel = torch::zeros({kSide, kSide}, torch::kFloat64);
  for (int64_t y = 0; y < kSide; ++y) {
    for (int64_t x = 0; x < kSide; ++x) {
      const double dx = std::min<double>(x, kSide - x), dy = std::min<double>(y, kSide - y);
      kernel[y][x] = std::exp(-(dx * dx + dy * dy) / (2 * kDeviation * kDeviation));
    }
  }
  kernel /= kernel.sum();
  const auto sharp = noise(60, 16, kSide);
  const auto blurred = torch::real(torch::fft_ifft2(torch::fft_fft2(sharp) * torch::fft_fft2(kernel)));
  const auto ratio = ring_amplitudes(blurred, 15) / ring_amplitudes(sharp, 15);
  for (int64_t ring = 0; ring <= 15; ++ring) {
    // The mean of the Gaussian's transform over the ring's frequencies.
    double sum = 0, count = 0;
    for (int64_t ky = -kSide / 2; ky < kSide / 2; ++ky) {
      for (int64_t kx = -kSide / 2; kx < kSide / 2; ++kx) {
        if (std::lround(std::hypot(kx, ky)) != ring) continue;
        const double frequency = 2 * std::acos(-1.0) / kSide * kDeviation;
        sum += std::exp(-(kx * kx + ky * ky) * frequency * frequency / 2);
        count += 1;
      }
    }
    EXPECT_NEAR(ratio[ring].item<double>() / (sum / count), 1, 0.02) << ring;
  }
  EXPECT_LT(band_ratio(ring_amplitudes(blurred, 15), ring_amplitudes(sharp, 15), 8, 15), 0.4);
}

TEST(RingAmplitudes, OfAWaveAreInItsRing) {
  auto picture = torch::zeros({1, 1, 16, 16}, torch::kFloat32);
  for (int64_t x = 0; x < 16; ++x)
    picture.select(3, x).fill_(3 + std::cos(2 * std::acos(-1.0) * 5 * static_cast<double>(x) / 16));
  const auto rings = ring_amplitudes(picture, last_whole_ring(16));
  EXPECT_EQ(rings.size(0), 8);
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
