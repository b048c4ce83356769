#pragma once

#include "gld/cameras/camera.h"
#include "models/bundle/bundle.h"
#include "models/refiner/denoising_unet.h"
#include "models/refiner/reference_views.h"

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// Returns whether latents of this bundle can be repaired: it has a refiner's weights and the statistics that it learnt
// under.
bool has_refiner(const ModelBundle& bundle);

// Repairs latents of one scene beside the views nearest to them, a call a view.
class LatentRefining {
 public:
  // encoded is (views, channels, height, width) of the views with these cameras, normalised by the bundle's statistics.
  // They may be fewer than the refiner's references; of attention grid as many are taken as leave no cell empty. unet
  // outlives this.
  LatentRefining(const DenoisingUnet& unet, std::vector<Camera> cameras, torch::Tensor encoded);

  // degraded is (channels, height, width), normalised. No gradients are recorded.
  torch::Tensor operator()(const Camera& camera, const torch::Tensor& degraded) const;

 private:
  const DenoisingUnet& unet_;
  std::vector<Camera> cameras_;
  torch::Tensor encoded_;
};

// Returns how many references a refiner takes of so many views.
int64_t references_taken(const RefinerOptions& options, int64_t available);

}  // namespace gld
