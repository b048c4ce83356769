#pragma once

#include "gld/cameras/camera.h"
#include "models/refiner/denoising_unet.h"
#include "models/refiner/reference_views.h"

#include <cstdint>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Returns how many references a refiner takes of so many views: at most its own number, and of attention grid as many
// as leave no cell empty.
int64_t references_taken(const RefinerOptions& options, int64_t available);
// Returns which of the views with these cameras they are for a view taken by `camera`, nearest first.
std::vector<int64_t> references_of(const RefinerOptions& options, const Camera& camera,
                                   const std::vector<Camera>& cameras);

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
  // They may be fewer than the refiner's references. unet outlives this. where is what errors name: "refining latents".
  // Throws Error where a call would not fit into what the CPU has of memory.
  LatentRefining(const DenoisingUnet& unet, std::vector<Camera> cameras, torch::Tensor encoded,
                 std::string where = "refining latents");

  // degraded is (channels, height, width), normalised. No gradients are recorded. Throws Error where a number is not
  // finite.
  torch::Tensor operator()(const Camera& camera, const torch::Tensor& degraded) const;

 private:
  const DenoisingUnet& unet_;
  std::vector<Camera> cameras_;
  torch::Tensor encoded_;
  std::string where_;
};

}  // namespace gld
