#pragma once

#include "gld/cameras/camera.h"
#include "models/refiner/denoising_unet.h"
#include "models/refiner/reference_views.h"

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// Returns how many references a refiner takes of so many views: at most its own number, and of attention grid as many
// as leave no cell empty.
int64_t references_taken(const RefinerOptions& options, int64_t available);

// Returns what a refiner sees of a degraded view, (channels, height, width), taken by `camera`: it, and the latents of
// the references nearest to it among `encoded`, (views, channels, height, width) of these cameras; (1 + references,
// channels, height, width).
torch::Tensor beside_references(const RefinerOptions& options, const Camera& camera,
                                const torch::Tensor& degraded, const std::vector<Camera>& cameras,
                                const torch::Tensor& encoded);

// Repairs latents of one scene beside the views nearest to them, a call a view.
class LatentRefining {
 public:
  // encoded is (views, channels, height, width) of the views with these cameras, normalised by the bundle's statistics.
  // They may be fewer than the refiner's references. unet outlives this.
  LatentRefining(const DenoisingUnet& unet, std::vector<Camera> cameras, torch::Tensor encoded);

  // degraded is (channels, height, width), normalised. No gradients are recorded.
  torch::Tensor operator()(const Camera& camera, const torch::Tensor& degraded) const;

 private:
  const DenoisingUnet& unet_;
  std::vector<Camera> cameras_;
  torch::Tensor encoded_;
};

}  // namespace gld
