#pragma once

#include "gld/files/weight_file.h"
#include "gld/latents/streaming_moments.h"

#include <filesystem>
#include <map>
#include <string>

#include <torch/types.h>

namespace gld {

// Mean and variance of each channel of a level over all patch tokens and views (DESIGN.md section 4, "Latent
// statistics"). What turns features into latents: z = (f - mean) / sqrt(variance + epsilon).
struct LatentStatistics {
  torch::Tensor mean;      // (channels), float32
  torch::Tensor variance;  // (channels), float32
  double epsilon = 1e-5;

  int64_t channels() const { return mean.size(0); }
  torch::Tensor normalise(const torch::Tensor& features) const;  // (..., channels) -> the same shape
  torch::Tensor denormalise(const torch::Tensor& latent) const;  // the inverse
  LatentStatistics to(torch::Device device) const;
};

// Reads "mean" and "var", of shape (channels) or (1, channels, 1, 1), with an optional prefix; other entries (std,
// counts) are not used. The published files are such. Throws Error where they are missing, misshapen or not finite, or
// where a variance is negative.
LatentStatistics read_latent_statistics(const WeightFile& file, const std::string& prefix = "",
                                        double epsilon = 1e-5);
LatentStatistics read_latent_statistics(const std::filesystem::path& file, double epsilon = 1e-5);

// Returns "mean" and "var" (channels), which a bundle holds.
std::map<std::string, torch::Tensor> statistics_tensors(const LatentStatistics& statistics);

LatentStatistics statistics_of(const StreamingMoments& moments, double epsilon = 1e-5);
// features is (..., channels), of any number of tokens.
void add_features(StreamingMoments& moments, const torch::Tensor& features);

}  // namespace gld
