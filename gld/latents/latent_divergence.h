#pragma once

#include "gld/latents/latent_statistics.h"

namespace gld {

// Returns how far features are from those that statistics are of: the Kullback-Leibler divergence of their normal
// distribution from the statistics', mean over the channels, in nats: (v + m^2 - 1 - ln v) / 2 of each, with the mean m
// and the variance v of the features as the statistics normalise them. It is 0 where both are equal; few tokens have
// more of it than many by chance alone.
double latent_divergence(const LatentStatistics& of_scene, const LatentStatistics& statistics);
// features is (..., channels), of any number of tokens, at least two.
double latent_divergence(const torch::Tensor& features, const LatentStatistics& statistics);

}  // namespace gld
