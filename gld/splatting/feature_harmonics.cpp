#include "gld/splatting/feature_harmonics.h"

#include "gld/splatting/spherical_harmonics.h"

namespace gld {

std::vector<float> feature_harmonics(const GaussianSet& set, const SplatView& view, int64_t degree,
                                     const KernelSettings& settings) {
  const int64_t each = harmonic_coefficients(degree);
  std::vector<float> values(static_cast<size_t>(view.size() * each));
#pragma omp parallel for num_threads(settings.threads) schedule(static)
  for (int64_t i = 0; i < view.size(); ++i) {
    const int64_t index = view.splats[static_cast<size_t>(i)].index;
    Eigen::Vector3d from_camera = view.camera.offset;
    for (int k = 0; k < 3; ++k) from_camera[k] += set.means[static_cast<size_t>(3 * index + k)];
    const Eigen::Vector3d direction = from_camera.normalized();
    double harmonics[kMostHarmonicCoefficients];
    spherical_harmonics(degree, direction.data(), harmonics);
    for (int64_t k = 0; k < each; ++k)
      values[static_cast<size_t>(i * each + k)] = static_cast<float>(harmonics[k] / harmonics[0]);
  }
  return values;
}

std::vector<float> seen_features(const GaussianSet& set, const SplatView& view, const float* features,
                                 int64_t degree, int64_t channels, const KernelSettings& settings) {
  const int64_t each = harmonic_coefficients(degree);
  const std::vector<float> harmonics = feature_harmonics(set, view, degree, settings);
  std::vector<float> seen(static_cast<size_t>(view.size() * channels), 0.0F);
#pragma omp parallel for num_threads(settings.threads) schedule(static)
  for (int64_t i = 0; i < view.size(); ++i) {
    const float* const from = features + view.splats[static_cast<size_t>(i)].index * each * channels;
    float* const to = seen.data() + i * channels;
    for (int64_t k = 0; k < each; ++k) {
      const float factor = harmonics[static_cast<size_t>(i * each + k)];
      for (int64_t c = 0; c < channels; ++c) to[c] += factor * from[k * channels + c];
    }
  }
  return seen;
}

}  // namespace gld
