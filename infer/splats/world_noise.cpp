#include "infer/splats/world_noise.h"

#include "gld/base/philox.h"
#include "gld/cameras/resized_camera.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

constexpr int64_t kChannels = 6, kWaves = 24;
// Periods a latent pixel. On surfaces farther than usual or seen aslant they are higher.
constexpr double kLowest = 0.04, kHighest = 0.45;
constexpr int64_t kPlacesAside = 4;
constexpr double kPi = 3.14159265358979323846;
constexpr float kSeen = 0.5F;

double uniform(uint32_t bits) { return (static_cast<double>(bits) + 0.5) / 4294967296.0; }

double sum_of_waves(const WorldNoise& noise, int64_t channel, const Eigen::Vector3d& at) {
  double sum = 0;
  for (int64_t w = channel * noise.waves_each(); w < (channel + 1) * noise.waves_each(); ++w) {
    const auto number = static_cast<size_t>(w);
    sum += std::cos(noise.waves[number].dot(at) + noise.phases[number]);
  }
  return sum;
}

// Returns the weights of places in latent pixels along one side, (latent_side, latent_side kPlacesAside), rows of
// sum 1.
torch::Tensor low_pass(int64_t latent_side) {
  const auto pixels = torch::arange(latent_side, torch::kFloat64) + 0.5;
  const auto places = (torch::arange(latent_side * kPlacesAside, torch::kFloat64) + 0.5) / kPlacesAside;
  const auto apart = places.unsqueeze(0) - pixels.unsqueeze(1);
  const auto weights = apart.square().div(-2 * kPixelVariance).exp();
  return weights / weights.sum(1, /*keepdim=*/true);
}

}  // namespace

WorldNoise make_world_noise(double pixel, uint64_t seed) {
  WorldNoise noise;
  noise.channels = kChannels;
  const PhiloxKey key = philox_key(seed, "world noise");
  for (int64_t i = 0; i < kChannels * kWaves; ++i) {
    const auto random = philox4x32({static_cast<uint32_t>(i), 0, 0, 0}, key);
    // Even over the sphere: z even, and the angle about it.
    const double z = 2 * uniform(random[0]) - 1, angle = 2 * kPi * uniform(random[1]);
    const double across = std::sqrt(std::max(0.0, 1 - z * z));
    const double periods = kLowest + (kHighest - kLowest) * uniform(random[2]);
    noise.waves.push_back(Eigen::Vector3d(across * std::cos(angle), across * std::sin(angle), z) *
                          (2 * kPi * periods / pixel));
    noise.phases.push_back(2 * kPi * uniform(random[3]));
  }
  return noise;
}

SplatImage seen_places(const StillGaussians& gaussians, const Camera& camera,
                       const KernelSettings& settings) {
  constexpr int64_t kPlace = 4;
  const int64_t count = gaussians.set.size();
  std::vector<float> places(static_cast<size_t>(count * kPlace));
  for (int64_t i = 0; i < count; ++i) {
    for (int64_t k = 0; k < 3; ++k)
      places[static_cast<size_t>(kPlace * i + k)] = gaussians.set.means[static_cast<size_t>(3 * i + k)];
    places[static_cast<size_t>(kPlace * i + 3)] = 1;
  }
  SplatImage seen = rendered_features(gaussians, feature_tensor(places, kPlace), camera, settings);
  for (int64_t y = 0; y < seen.height; ++y) {
    for (int64_t x = 0; x < seen.width; ++x) {
      const float covered = seen.row(3, y)[x];
      for (int64_t k = 0; k < 3 && covered > 0; ++k) seen.row(k, y)[x] /= covered;
    }
  }
  return seen;
}

double typical_pixel(const StillGaussians& gaussians, int64_t latent_side, const KernelSettings& settings) {
  std::vector<double> pixels;
  for (const Camera& of_image : gaussians.cameras) {
    const Camera camera = resized_camera(of_image, latent_side, latent_side);
    const SplatImage seen = seen_places(gaussians, camera, settings);
    const Eigen::Vector3d axis = camera.world_from_camera.linear().col(2);
    const Eigen::Vector3d centre = camera.world_from_camera.translation() - gaussians.set.origin;
    const double focal = std::sqrt(camera.intrinsics(0, 0) * camera.intrinsics(1, 1));
    for (int64_t y = 0; y < seen.height; ++y) {
      for (int64_t x = 0; x < seen.width; ++x) {
        if (seen.row(3, y)[x] < kSeen) continue;
        const Eigen::Vector3d place(seen.row(0, y)[x], seen.row(1, y)[x], seen.row(2, y)[x]);
        pixels.push_back(axis.dot(place - centre) / focal);
      }
    }
  }
  if (pixels.empty()) return 1;
  const auto middle = pixels.begin() + static_cast<std::ptrdiff_t>(pixels.size() / 2);
  std::nth_element(pixels.begin(), middle, pixels.end());
  return std::max(*middle, 1e-30);
}

torch::Tensor noise_picture(const WorldNoise& noise, const StillGaussians& gaussians, const Camera& camera,
                            int64_t latent_side, const KernelSettings& settings) {
  const int64_t side = latent_side * kPlacesAside, places = side * side;
  const SplatImage seen = seen_places(gaussians, resized_camera(camera, side, side), settings);
  auto fine = torch::zeros({noise.channels, side, side}, torch::kFloat64);
  double* const values = fine.data_ptr<double>();
  const double size = std::sqrt(2.0 / static_cast<double>(noise.waves_each()));
#pragma omp parallel for num_threads(settings.threads) schedule(static)
  for (int64_t place = 0; place < places; ++place) {
    const int64_t x = place % side, y = place / side;
    if (seen.row(3, y)[x] < kSeen) continue;
    const Eigen::Vector3d at(seen.row(0, y)[x], seen.row(1, y)[x], seen.row(2, y)[x]);
    // The values are about 1, so that there is a DC to divide by.
    for (int64_t c = 0; c < noise.channels; ++c)
      values[c * places + place] = 1 + size * sum_of_waves(noise, c, at);
  }
  const auto rows = low_pass(latent_side);
  return rows.matmul(fine).matmul(rows.t()).to(torch::kFloat32);
}

}  // namespace gld
