#pragma once

#include "models/splats/latent_fit.h"

#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace gld {

// A texture that is fixed in the world, as the control of what splatting does to latents: seen from everywhere the same
// by construction, so that what of it is lost is lost to splatting. A sum of plane waves of random directions and
// phases, a channel at a time; their frequencies are even between two ends in periods a latent pixel at the scene's
// typical distance.
struct WorldNoise {
  int64_t channels = 0;
  std::vector<Eigen::Vector3d> waves;  // (channels, waves each), radians a unit of the world
  std::vector<double> phases;

  int64_t waves_each() const { return static_cast<int64_t>(waves.size()) / channels; }
};
// pixel is what a latent pixel covers of a surface there, in units of the world.
WorldNoise make_world_noise(double pixel, uint64_t seed);

// Returns where the Gaussians lie that a camera sees, per pixel: their means by weight, relative to the set's origin,
// and how much of the pixel they cover, 4 channels.
SplatImage seen_places(const StillGaussians& gaussians, const Camera& camera, const KernelSettings& settings);

// Returns the median over views of what a pixel of a latent with so many a side covers of what it sees.
double typical_pixel(const StillGaussians& gaussians, int64_t latent_side, const KernelSettings& settings);

// Returns the texture at the places that a view sees, (channels, latent_side, latent_side), 0 far from what is seen,
// through the low pass that a splatter draws through: a Gaussian of kPixelVariance about each latent pixel, over four
// by four places a pixel. A mean over the pixel's square would let frequencies beyond its own through, which are
// aliased in each view otherwise: the texture would not be the same from everywhere, and what the features cannot show
// of it would be taken for the blur of splatting.
torch::Tensor noise_picture(const WorldNoise& noise, const StillGaussians& gaussians, const Camera& camera,
                            int64_t latent_side, const KernelSettings& settings);

}  // namespace gld
