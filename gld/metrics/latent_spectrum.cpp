#include "gld/metrics/latent_spectrum.h"

#include "gld/base/error.h"

#include <cmath>
#include <string>

#include <fmt/format.h>

namespace gld {
namespace {

// Returns the ring of each frequency of an n by n transform, in the transform's order.
std::vector<int64_t> rings_of(int64_t side) {
  std::vector<int64_t> rings;
  rings.reserve(static_cast<size_t>(side * side));
  const auto frequency = [&](int64_t k) { return static_cast<double>(k <= side / 2 ? k : k - side); };
  for (int64_t y = 0; y < side; ++y) {
    for (int64_t x = 0; x < side; ++x) rings.push_back(std::lround(std::hypot(frequency(y), frequency(x))));
  }
  return rings;
}

}  // namespace

int64_t last_whole_ring(int64_t side) { return side / 2 - 1; }

torch::Tensor ring_amplitudes(const torch::Tensor& latents, int64_t last_ring, SpectrumWindow window) {
  if (latents.dim() != 4 || latents.size(2) != latents.size(3) || latents.size(0) < 1 ||
      latents.size(1) < 1) {
    std::string found;
    for (const int64_t size : latents.sizes()) found += (found.empty() ? "" : ", ") + std::to_string(size);
    fail({"spectrum of latents", "(views, channels, n, n)", "(" + found + ")", "cut squares out"});
  }
  const int64_t side = latents.size(2);
  if (last_ring < 0 || last_ring > side / 2) {
    fail({"spectrum of latents", fmt::format("rings up to {} of a grid of {}", side / 2, side),
          std::to_string(last_ring), "ask for fewer, or take larger latents"});
  }
  auto values = latents.to(torch::kCPU, torch::kFloat64);
  const auto mean = values.mean(std::vector<int64_t>{2, 3}, true);
  if (window == SpectrumWindow::kHann) {
    auto hann = torch::hann_window(side, /*periodic=*/true, torch::kFloat64);
    hann = hann / hann.square().mean().sqrt();
    values = (values - mean) * hann * hann.unsqueeze(1);
  }
  auto amplitude = torch::fft_fft2(values).abs().mean(std::vector<int64_t>{0, 1}).reshape({-1});
  amplitude[0] = mean.abs().mean() * static_cast<double>(side * side);
  const auto rings = torch::tensor(rings_of(side), torch::kInt64);
  const auto sums = torch::zeros({side * 2}, torch::kFloat64).index_add(0, rings, amplitude);
  const auto counts =
      torch::zeros({side * 2}, torch::kFloat64).index_add(0, rings, torch::ones_like(amplitude));
  return (sums / counts).slice(0, 0, last_ring + 1).contiguous();
}

double band_ratio(const torch::Tensor& rendered, const torch::Tensor& encoded, int64_t first, int64_t last) {
  return (rendered.slice(0, first, last + 1) / encoded.slice(0, first, last + 1)).mean().item<double>();
}

torch::Tensor principal_pictures(const torch::Tensor& latents, const torch::Tensor& like) {
  const int64_t channels = like.size(1);
  const auto points = like.to(torch::kFloat64).permute({0, 2, 3, 1}).reshape({-1, channels});
  const auto mean = points.mean(0, true);
  const auto centred = points - mean;
  const auto covariance = centred.t().matmul(centred) / static_cast<double>(points.size(0));
  const auto [values, vectors] = torch::linalg_eigh(covariance);
  const int64_t shown = std::min<int64_t>(3, channels);
  // Directions come from the largest; the sign of a direction is free: its largest number is positive.
  auto directions = vectors.slice(1, channels - shown, channels).flip({1});
  const auto largest = directions.gather(0, directions.abs().argmax(0, true));
  directions = directions * largest.sign();
  const auto deviations = values.slice(0, channels - shown, channels).flip({0}).clamp_min(1e-30).sqrt();
  constexpr double kDeviations = 2.5;
  const auto projected =
      ((latents.to(torch::kFloat64).permute({0, 2, 3, 1}) - mean).matmul(directions) / deviations) /
          (2 * kDeviations) +
      0.5;
  auto pictures = torch::full({latents.size(0), latents.size(2), latents.size(3), 3}, 0.5, torch::kFloat32);
  pictures.slice(3, 0, shown).copy_(projected.clamp(0, 1));
  return pictures.permute({0, 3, 1, 2}).contiguous();
}

}  // namespace gld
