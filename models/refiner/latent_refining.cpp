#include "models/refiner/latent_refining.h"

#include "gld/base/error.h"
#include "gld/machine/stage_record.h"
#include "models/refiner/view_grid.h"

#include <algorithm>
#include <utility>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {

int64_t references_taken(const RefinerOptions& options, int64_t available) {
  const int64_t most = std::min(options.references, available);
  return options.attention == ViewAttention::kGrid ? views_in_whole_grid(1 + most) - 1 : most;
}

std::vector<int64_t> references_of(const RefinerOptions& options, const Camera& camera,
                                   const std::vector<Camera>& cameras) {
  const int64_t taken = references_taken(options, static_cast<int64_t>(cameras.size()));
  return nearest_references(camera, cameras, taken, options.reference_unit);
}

torch::Tensor beside_references(const RefinerOptions& options, const Camera& camera,
                                const torch::Tensor& degraded, const std::vector<Camera>& cameras,
                                const torch::Tensor& encoded) {
  std::vector<torch::Tensor> views = {degraded};
  for (const int64_t view : references_of(options, camera, cameras)) views.push_back(encoded[view]);
  return torch::stack(views);
}

LatentRefining::LatentRefining(const DenoisingUnet& unet, std::vector<Camera> cameras, torch::Tensor encoded,
                               std::string where)
    : unet_(unet), cameras_(std::move(cameras)), encoded_(std::move(encoded)), where_(std::move(where)) {
  if (!encoded_.device().is_cpu()) return;
  const int64_t views = 1 + references_taken(unet_.options(), static_cast<int64_t>(cameras_.size()));
  const int64_t height = encoded_.size(2), width = encoded_.size(3);
  const int64_t needed = refiner_cost(unet_.options(), views, height, width).working_bytes;
  const int64_t available = available_memory_bytes();
  if (available <= 0 || needed <= available) return;
  fail({where_, fmt::format("at most {} of memory", bytes_text(available)),
        fmt::format("{} for {} views of {}x{} latent pixels by the forecast", bytes_text(needed), views,
                    width, height),
        "take smaller views"});
}

torch::Tensor LatentRefining::operator()(const Camera& camera, const torch::Tensor& degraded) const {
  const torch::NoGradGuard no_grad;
  const auto views = beside_references(unet_.options(), camera, degraded, cameras_, encoded_);
  auto refined = refined_latents(unet_, views.unsqueeze(0))[0];
  if (!refined.isfinite().all().item<bool>()) {
    fail({where_, "finite numbers", "NaN or infinity in the repaired latents",
          "check the refiner with gld inspect"});
  }
  return refined;
}

}  // namespace gld
