#include "infer/forecast/stage_speed.h"

#include "gld/machine/timing.h"
#include "models/backbones/da3_backbone.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/rgb_decoder.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

// Of any size, as long as no number is a NaN or a denormal, which would be slow.
void fill(torch::nn::Module& module) {
  for (auto& parameter : module.parameters()) {
    if (!parameter.is_floating_point()) continue;
    const double range =
        parameter.dim() < 2 ? 0.5 : 1 / std::sqrt(static_cast<double>(parameter.numel() / parameter.size(0)));
    parameter.uniform_(-range, range);
  }
}

LatentGrid grid_of_views(LatentGrid grid, int64_t views) {
  grid.views = views;
  return grid;
}

std::vector<torch::Tensor> random_levels(const BundleOptions& bundle, const LatentGrid& grid) {
  std::vector<torch::Tensor> levels;
  for (size_t i = 0; i < bundle.backbone.out_layers.size(); ++i) {
    levels.push_back(torch::randn({grid.views, grid.tokens_per_view(), bundle.backbone.level_channels()}));
  }
  return levels;
}

double encoding_seconds(const BundleOptions& bundle, const PlanRequest& request) {
  Da3Backbone backbone(bundle.backbone, ParameterPlacement{});
  fill(backbone);
  const int64_t side = bundle.backbone.patch_size;
  const auto images =
      torch::randn({request.num_sources, 3, request.grid.height * side, request.grid.width * side});
  const int64_t last_level =
      request.source_depth() ? static_cast<int64_t>(bundle.backbone.out_layers.size()) - 1 : 1;
  return seconds_of([&] {
    backbone.encode(images, last_level);
    if (request.num_sources > 1) backbone.encode(images.narrow(0, 0, 1), 1);
  });
}

double propagation_seconds(const BundleOptions& bundle, const PlanRequest& request) {
  Da3Backbone backbone(bundle.backbone, ParameterPlacement{});
  fill(backbone);
  PropagationStart start;
  start.level = 1;
  start.grid = request.grid;
  start.tokens = torch::randn(
      {request.grid.views, request.grid.tokens_per_view() + 1, bundle.backbone.level_channels()});
  return seconds_of([&] { backbone.propagate(start); });
}

double decoding_seconds(const BundleOptions& bundle, const LatentGrid& grid) {
  RgbDecoder decoder(bundle.rgb_decoder, ParameterPlacement{});
  fill(decoder);
  const auto features = torch::cat(random_levels(bundle, grid), 2);
  return seconds_of([&] { decoder.decode(features, grid); });
}

double geometry_seconds(const BundleOptions& bundle, const LatentGrid& grid, GeometryMaps maps) {
  DptHead head(bundle.dpt_head, ParameterPlacement{});
  fill(head);
  const auto levels = random_levels(bundle, grid);
  return seconds_of([&] { head.forward(levels, grid, maps); });
}

}  // namespace

double measure_stage_seconds(const std::string& stage, const BundleOptions& bundle,
                             const PlanRequest& request) {
  const torch::NoGradGuard no_gradients;
  const LatentGrid sources = grid_of_views(request.grid, request.num_sources);
  const LatentGrid targets = grid_of_views(request.grid, request.grid.views - request.num_sources);
  if (stage == "source encoding") return encoding_seconds(bundle, request);
  if (stage == "view pairs") return geometry_seconds(bundle, sources, GeometryMaps::kDepthAndRays);
  if (stage == "propagation") return propagation_seconds(bundle, request);
  if (stage == "RGB decoding") return decoding_seconds(bundle, targets);
  if (stage == "geometry") {
    return geometry_seconds(bundle, request.outputs.points ? request.grid : targets, request.geometry_maps());
  }
  return 0;
}

}  // namespace gld
