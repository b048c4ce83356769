#include "infer/pipeline/geometry_of_pictures.h"

#include "gld/base/error.h"
#include "gld/cameras/latent_grid.h"
#include "models/conditioning/decoder_inputs.h"
#include "models/latent_spaces/latent_space.h"

#include <utility>
#include <vector>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {

GeometryOutput geometry_of_pictures(const PipelineModels& models, const torch::Tensor& pictures,
                                    GeometryMaps wanted, const torch::Device& device,
                                    const std::vector<Camera>& known_cameras) {
  const torch::NoGradGuard no_gradients;
  const int64_t height = pictures.size(2), width = pictures.size(3);
  auto images = pictures.clamp(0, 1).to(device);
  GeometryInputs inputs;
  LatentGrid grid;
  {
    const auto backbone =
        models.geometry_model_backbone ? models.geometry_model_backbone() : models.backbone();
    const auto& architecture = backbone->architecture();
    const int64_t side = architecture.patch_side();
    const std::vector<int64_t> size = {nearest_whole_patches(height, side) * side,
                                       nearest_whole_patches(width, side) * side};
    if (size[0] != height || size[1] != width) {
      images = torch::upsample_bilinear2d(images, size, /*align_corners=*/false);
    }
    grid = architecture.grid_of(images.size(0), size[0], size[1]);
    const int64_t last = architecture.levels() - 1;
    const LatentSpace space(backbone, last);  // nothing is propagated
    inputs = geometry_inputs(space, known_cameras.empty()
                                        ? space.encode(images, last)
                                        : backbone->encode_with_cameras(images, last, known_cameras));
  }
  const auto head = models.geometry_model_head ? models.geometry_model_head() : models.geometry_head();
  auto maps = head->look(inputs, grid, wanted);
  const auto resized = [&](const torch::Tensor& channels_first) {
    return torch::upsample_bilinear2d(channels_first, {height, width}, /*align_corners=*/false);
  };
  for (torch::Tensor* map : {&maps.depth, &maps.depth_confidence, &maps.points, &maps.point_confidence}) {
    if (!map->defined() || (map->size(1) == height && map->size(2) == width)) continue;
    *map = map->dim() == 3 ? resized(map->unsqueeze(1)).squeeze(1)
                           : resized(map->permute({0, 3, 1, 2})).permute({0, 2, 3, 1}).contiguous();
  }
  for (torch::Tensor* map : {&maps.depth, &maps.depth_confidence, &maps.rays, &maps.ray_confidence,
                             &maps.points, &maps.point_confidence, &maps.camera_encodings}) {
    if (map->defined()) *map = map->to(pictures.device());
  }
  return maps;
}

void require_finite_geometry(const GeometryOutput& geometry, const std::string& stage) {
  const std::pair<const char*, const torch::Tensor&> maps[] = {
      {"depth", geometry.depth},
      {"confidence of depth", geometry.depth_confidence},
      {"rays", geometry.rays},
      {"confidence of rays", geometry.ray_confidence},
      {"points", geometry.points},
      {"confidence of points", geometry.point_confidence},
      {"cameras", geometry.camera_encodings}};
  for (const auto& [name, map] : maps) {
    if (!map.defined() || map.isfinite().all().item<bool>()) continue;
    const auto wrong = map.numel() - map.isfinite().sum().item<int64_t>();
    fail({stage, "finite numbers",
          fmt::format("{} of {} values of the predicted {} that are not", wrong, map.numel(), name),
          "check the geometry head's weights with gld inspect and gld verify"});
  }
}

}  // namespace gld
