#include "models/splats/latent_refining.h"

#include "gld/base/error.h"
#include "gld/machine/stage_record.h"
#include "models/refiner/view_grid.h"

#include <algorithm>
#include <utility>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {

bool has_refiner(const ModelBundle& bundle) {
  // Refiners are of autoencoders, which have one level.
  return bundle.options().refiner.exists() && bundle.has(BundlePart::refiner()) &&
         bundle.has(BundlePart::statistics(0));
}

int64_t references_taken(const RefinerOptions& options, int64_t available) {
  const int64_t most = std::min(options.references, available);
  return options.attention == ViewAttention::kGrid ? views_in_whole_grid(1 + most) - 1 : most;
}

LatentRefining::LatentRefining(const DenoisingUnet& unet, std::vector<Camera> cameras, torch::Tensor encoded)
    : unet_(unet), cameras_(std::move(cameras)), encoded_(std::move(encoded)) {
  const int64_t views = 1 + references_taken(unet_.options(), static_cast<int64_t>(cameras_.size()));
  const int64_t height = encoded_.size(2), width = encoded_.size(3);
  const int64_t needed = refiner_cost(unet_.options(), views, height, width).working_bytes;
  const int64_t available = available_memory_bytes();
  if (available <= 0 || needed <= available) return;
  fail({"refining latents", fmt::format("at most {} of memory", bytes_text(available)),
        fmt::format("{} for {} views of {}x{} latent pixels by the forecast", bytes_text(needed), views,
                    width, height),
        "take smaller views"});
}

torch::Tensor LatentRefining::operator()(const Camera& camera, const torch::Tensor& degraded) const {
  const torch::NoGradGuard no_grad;
  const auto available = static_cast<int64_t>(cameras_.size());
  std::vector<torch::Tensor> views = {degraded};
  for (const int64_t view : nearest_references(camera, cameras_, references_taken(unet_.options(), available),
                                               unet_.options().reference_unit))
    views.push_back(encoded_[view]);
  auto refined = refined_latents(unet_, torch::stack(views).unsqueeze(0))[0];
  if (!refined.isfinite().all().item<bool>()) {
    fail({"refining latents", "finite latents", "NaN or infinity", "check the refiner with gld inspect"});
  }
  return refined;
}

}  // namespace gld
