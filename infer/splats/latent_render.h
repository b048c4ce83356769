#pragma once

#include "infer/splats/splat_render.h"

namespace gld {

// gld splat render, latents included: run_splat_render, and what --show latents and refined draw of the features beside
// the Gaussians.
void run_splat_render_with_latents(const SplatRenderOptions& options);

}  // namespace gld
