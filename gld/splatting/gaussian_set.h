#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace gld {

constexpr int64_t kMostHarmonicDegree = 3;

// Returns how many coefficients spherical harmonics have up to a degree: 1, 4, 9 or 16.
constexpr int64_t harmonic_coefficients(int64_t degree) { return (degree + 1) * (degree + 1); }
// Returns the degree with so many coefficients, -1 for none.
constexpr int64_t degree_of_coefficients(int64_t coefficients) {
  for (int64_t degree = 0; degree <= kMostHarmonicDegree; ++degree) {
    if (harmonic_coefficients(degree) == coefficients) return degree;
  }
  return -1;
}

// A scene as n 3D Gaussians (Kerbl et al. 2023). Each array holds n rows. Gradients of a loss, moments of Adam and the
// like are sets of the same shape.
struct GaussianSet {
  // Where the means' zero lies in the world: a scene far from the world's origin keeps its digits so.
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  int64_t degree = 0;             // of the colour's spherical harmonics, 0 to 3
  std::vector<float> means;       // (n, 3) relative to origin
  std::vector<float> log_scales;  // (n, 3) natural logarithm of the standard deviation along each axis
  std::vector<float>
      rotations;  // (n, 4) quaternion w, x, y, z of any length but 0: world from the Gaussian's axes
  std::vector<float> logit_opacities;  // (n)
  std::vector<float> colours;          // (n, 3) coefficient 0 of red, green, blue
  std::vector<float> harmonics;        // (n, harmonic_coefficients(degree) - 1, 3) the others
  int64_t channels = 0;                // of features
  std::vector<float> features;  // (n, channels) what is seen beside colour, from all sides alike: latents

  int64_t size() const { return static_cast<int64_t>(logit_opacities.size()); }
  int64_t harmonics_each() const { return 3 * (harmonic_coefficients(degree) - 1); }
  // Returns where Gaussian i lies in the world.
  Eigen::Vector3d mean_in_world(size_t i) const {
    return origin + Eigen::Vector3d(means[3 * i], means[3 * i + 1], means[3 * i + 2]);
  }
};

// One of a set's arrays: its name as messages say it and its numbers a Gaussian.
struct GaussianArray {
  const char* name;  // "mean"
  std::vector<float> GaussianSet::*values;
  int64_t each;
};
constexpr size_t kGaussianArrays = 7;
// The arrays are in the order of GaussianSet's declaration.
std::array<GaussianArray, kGaussianArrays> gaussian_arrays(const GaussianSet& set);

// Returns n Gaussians whose numbers are all 0, as sums of gradients begin.
GaussianSet zero_gaussians(int64_t count, int64_t degree);
// Returns the same with the degree, the channels and the origin of another set.
GaussianSet zero_gaussians_like(const GaussianSet& set, int64_t count);

// Throws Error that names the Gaussian and the parameter: a number that is not finite, a quaternion of length 0, arrays
// of the wrong length. where names the set ("splats.ply").
void check_gaussians(const GaussianSet& set, const std::string& where);

// Returns the Gaussians for which keep is not 0, in their order.
GaussianSet kept_gaussians(const GaussianSet& set, const std::vector<uint8_t>& keep);
// Puts Gaussian i of from behind the last of set; both have one degree and as many channels.
void append_gaussian(GaussianSet& set, const GaussianSet& from, int64_t i);

}  // namespace gld
