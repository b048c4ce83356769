#pragma once

#include "train/splats/splat_command.h"

namespace gld {

// Does gld splat fit, features included: run_splat_fit, and where --features names levels their latents are solved for
// the finished Gaussians, which stand still, in features.safetensors. All views are encoded together, fitted ones
// first; those that are held out are compared with what the features show. What is wrong with the model is said before
// the fit.
void run_splat_fit_with_features(const SplatCommandOptions& options);

}  // namespace gld
