#include "models/refiner/denoising_unet.h"
#include "models/refiner/one_step_update.h"
#include "models/refiner/reference_views.h"
#include "models/weights/weight_loading.h"
#include "verify/reference_runners.h"

#include <vector>

namespace gld {
namespace {

std::vector<Camera> cameras_of(const torch::Tensor& camera_to_world) {
  std::vector<Camera> cameras;
  const auto values = camera_to_world.to(torch::kFloat64).contiguous();
  const auto from = values.accessor<double, 3>();
  for (int64_t view = 0; view < values.size(0); ++view) {
    Camera camera;
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column)
        camera.world_from_camera.matrix()(row, column) = from[view][row][column];
    }
    cameras.push_back(camera);
  }
  return cameras;
}

}  // namespace

// The case has a refiner, latents of a degraded view and its references, and cameras of which the first one's
// references are asked.
NamedTensors run_refiner_case(const ReferenceCase& reference) {
  RefinerOptions options;
  reference.read_config(options);
  DenoisingUnet unet(options, reference.placement());
  load_strict(unet, reference.weight_file());
  reference.apply_precision(unet, ModelKind::kRunOnce);
  const auto latents = reference.module_input("latents", {-1, options.latent_channels, -1, -1}).unsqueeze(0);
  const auto cameras = cameras_of(reference.input("camera_to_world", {-1, 4, 4}));
  std::vector<double> left;
  for (int64_t timestep = 0; timestep < kDiffusionSteps; ++timestep) left.push_back(alpha_bar(timestep));
  const auto order = nearest_references(cameras.front(), {cameras.begin() + 1, cameras.end()},
                                        static_cast<int64_t>(cameras.size()) - 1, ReferenceUnit::kScene);
  return {{"prediction", unet.forward(latents, options.timestep)[0]},
          {"refined", refined_latents(unet, latents)[0]},
          {"alpha_bar", torch::tensor(left, torch::kFloat64).to(torch::kFloat32)},
          {"references", torch::tensor(order, torch::kInt64).to(torch::kFloat32)}};
}

}  // namespace gld
