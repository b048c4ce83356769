#pragma once

#include "gld/splatting/feature_solve.h"
#include "models/splats/latent_pictures.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

// Where the features of a run folder are, beside its Gaussians.
constexpr const char* kSplatFeaturesFile = "features.safetensors";

// Gaussians that stand still, and the views that see them.
struct StillGaussians {
  const GaussianSet& set;
  ProjectionOptions projection;
  std::vector<Camera> cameras;  // of the images, those that are fitted first
  int64_t fitted = 0;           // of these
};

// Features of a level that make the pictures of the fitted views, normalised: (gaussians, channels), or (gaussians,
// coefficients, channels) where they depend on the direction of view (gld/splatting/feature_harmonics.h).
struct LatentFit {
  LatentTag tag;
  LatentStatistics statistics;
  torch::Tensor features;
  torch::Tensor
      encoded;  // what the fitted views are encoded as, normalised, for a refiner; undefined of others
  int64_t iterations = 0;
  double residual = 0;  // SolvedFeatures, at last
  double seconds = 0;
};
LatentFit fit_latents(const StillGaussians& gaussians, const LatentPictures& latents,
                      const FeatureSolveOptions& options, const KernelSettings& settings);

// Returns what a camera sees of features, as LatentFit has them, over latent pixels; where nothing is seen it is 0, the
// mean of normalised latents.
SplatImage rendered_features(const StillGaussians& gaussians, const torch::Tensor& features,
                             const Camera& over_latents, const KernelSettings& settings);

// Returns the same of views `first` to `end`, over the pixels of these latents: (views, channels, height, width).
torch::Tensor rendered_views(const StillGaussians& gaussians, const torch::Tensor& features,
                             const LatentPictures& latents, int64_t first, int64_t end,
                             const KernelSettings& settings);

// Returns the relative_latent_error() of what features show of views `first` to `end`.
double latent_error(const StillGaussians& gaussians, const LatentFit& fit, const LatentPictures& latents,
                    int64_t first, int64_t end, const KernelSettings& settings);

// Writes beside a PLY file, for its Gaussians in its order: tensors levelN.features, as LatentFit has them,
// levelN.mean and levelN.deviation (channels), raw = features deviation + mean, and where a fit has them levelN.encoded
// (views, channels, height, width), float16; metadata "gld:latent_space" (tags as JSON), "gld:splats" (SHA-256 of the
// PLY file) and those of `notes`. The file is written whole or not at all.
void save_latent_fits(const std::filesystem::path& file, const std::vector<LatentFit>& fits,
                      const std::filesystem::path& splats,
                      const std::vector<std::pair<std::string, std::string>>& notes);

// Returns what that wrote, by level; `splats` is the PLY file that it must belong to. It is without iterations,
// residual and seconds. Throws Error naming the file and what is wrong with it.
std::vector<LatentFit> read_latent_fits(const std::filesystem::path& file,
                                        const std::filesystem::path& splats);

// Returns a table of numbers as a tensor: (rows, channels).
torch::Tensor feature_tensor(const std::vector<float>& values, int64_t channels);

}  // namespace gld
