#include "infer/forecast/stage_speed.h"

#include "gld/cameras/image_size.h"
#include "gld/cameras/latent_grid.h"
#include "gld/machine/timing.h"
#include "models/backbones/backbone.h"
#include "models/blending/photograph_blending.h"
#include "models/decoders/rgb_decoder.h"
#include "models/depth_refinement/depth_refinement.h"
#include "models/refiner/latent_refining.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

// Weights may have any size, as long as no number is a NaN or a denormal, which would be slow.
void fill(torch::nn::Module& module) {
  for (auto& parameter : module.parameters()) {
    if (!parameter.is_floating_point()) continue;
    double range = 0.5;
    if (parameter.dim() >= 2) {
      const int64_t inputs = parameter.numel() / parameter.size(0);
      range = 1 / std::sqrt(static_cast<double>(inputs));
    }
    parameter.uniform_(-range, range);
  }
}

std::vector<torch::Tensor> random_levels(const BundleOptions& bundle, const LatentGrid& grid) {
  std::vector<torch::Tensor> levels;
  for (size_t i = 0; i < static_cast<size_t>(bundle.backbone.levels()); ++i) {
    levels.push_back(torch::randn({grid.views, grid.tokens_per_view(), bundle.backbone.level_channels()}));
  }
  return levels;
}

double encoding_seconds(const BundleOptions& bundle, const PlanRequest& request) {
  const auto backbone = bundle.backbone.make(ParameterPlacement{});
  fill(*backbone);
  const int64_t side = bundle.backbone.patch_side();
  const auto images =
      torch::randn({request.num_sources, 3, request.grid.height * side, request.grid.width * side});
  const StageRequest stages = request.stage_request();
  const int64_t deepest = deepest_encoded_level(bundle.level_set(), stages);
  const bool encodes_leading =
      stages.decodes() && bundle.backbone.architecture().encodes_leading(request.num_sources);
  return seconds_of([&] {
    backbone->encode(images, deepest);
    if (encodes_leading) backbone->leading_for_propagation(images.narrow(0, 0, 1), bundle.boundary_level);
  });
}

// Returns the seconds for the source photographs and what is carried into the target views, together.
double warp_encoding_seconds(const BundleOptions& bundle, const PlanRequest& request) {
  const auto backbone = bundle.backbone.make(ParameterPlacement{});
  fill(*backbone);
  const int64_t side = bundle.backbone.patch_side();
  const auto images =
      torch::randn({request.grid.views, 3, request.grid.height * side, request.grid.width * side});
  return seconds_of([&] { backbone->encode(images, bundle.level_set().deepest_generated()); });
}

double propagation_seconds(const BundleOptions& bundle, const PlanRequest& request) {
  const auto backbone = bundle.backbone.make(ParameterPlacement{});
  fill(*backbone);
  PropagationStart start;
  start.level = bundle.boundary_level;
  start.grid = request.grid;
  start.tokens =
      torch::randn({request.grid.views, request.grid.tokens_per_view() + bundle.backbone.leading_tokens(),
                    bundle.backbone.level_channels()});
  return seconds_of([&] { backbone->propagate(start); });
}

double sample_refinement_seconds(const BundleOptions& bundle, const PlanRequest& request) {
  DenoisingUnet unet(bundle.refiner, ParameterPlacement{});
  fill(unet);
  const int64_t views = 1 + references_taken(bundle.refiner, request.num_sources);
  const auto inputs =
      torch::randn({1, views, bundle.refiner.latent_channels, request.grid.height, request.grid.width});
  const auto targets = static_cast<double>(request.grid.views - request.num_sources);
  return targets * seconds_of([&] { refined_latents(unet, inputs); });
}

double decoding_seconds(const BundleOptions& bundle, const LatentGrid& grid) {
  if (!bundle.has_rgb_decoder()) {
    const auto backbone = bundle.backbone.make(ParameterPlacement{});
    fill(*backbone);
    const auto latents = random_levels(bundle, grid).back();
    return seconds_of([&] { backbone->decode(latents, grid); });
  }
  RgbDecoder decoder(bundle.rgb_decoder, ParameterPlacement{});
  fill(decoder);
  const auto features = torch::randn({grid.views, grid.tokens_per_view(), bundle.rgb_decoder.in_channels});
  return seconds_of([&] { decoder.decode(features, grid); });
}

// Returns the seconds of the network alone; what photographs are carried by is found when it runs.
double blending_seconds(const BundleOptions& bundle, const PlanRequest& request) {
  PhotographBlending blending(bundle.blending, ParameterPlacement{});
  fill(blending);
  const int64_t side = bundle.backbone.patch_side();
  const ImageSize seen =
      image_within(side * request.grid.width, side * request.grid.height, bundle.blending.side);
  const auto inputs = torch::randn({1, PhotographBlending::kInputs, seen.height, seen.width});
  const auto targets = static_cast<double>(request.grid.views - request.num_sources);
  return targets * seconds_of([&] { blending.forward(inputs); });
}

double geometry_seconds(const BundleOptions& bundle, const LatentGrid& grid, GeometryMaps maps) {
  const auto head = bundle.geometry_head.make(ParameterPlacement{});
  fill(*head);
  GeometryInputs inputs;
  inputs.levels = random_levels(bundle, grid);
  inputs.leading =
      torch::randn({grid.views, bundle.backbone.leading_tokens(), bundle.backbone.level_channels()});
  return seconds_of([&] { head->forward(inputs, grid, maps); });
}

// Returns what the head takes to say how deep the source views are.
double source_geometry_seconds(const BundleOptions& bundle, const PlanRequest& request) {
  return geometry_seconds(bundle, with_views(request.grid, request.num_sources), GeometryMaps::kDepthAndRays);
}

// Returns the seconds of the network alone, likewise.
double depth_refinement_seconds(const BundleOptions& bundle, const PlanRequest& request) {
  DepthRefinement refinement(bundle.depth_refinement, ParameterPlacement{});
  fill(refinement);
  const ImageSize matched = largest_matched_size(bundle, request);
  const ImageSize seen = image_within(matched.width, matched.height, bundle.depth_refinement.side);
  const auto map = [&](std::vector<int64_t> channels) {
    channels.insert(channels.begin(), request.num_sources);
    channels.insert(channels.end(), {seen.height, seen.width});
    return torch::rand(channels);
  };
  const auto hypotheses = static_cast<int64_t>(kDepthFactors.size());
  const DepthEvidence evidence{map({3}),         map({1}), map({1}), map({1}), map({hypotheses, 3}),
                               map({hypotheses})};
  return seconds_of([&] { refinement.forward(evidence); });
}

// Returns the seconds of another backbone and its head, which look at the generated images.
double geometry_model_seconds(const BundleOptions& geometry, const BundleOptions& bundle,
                              const PlanRequest& request) {
  const LatentGrid grid = geometry_model_grid(geometry, bundle, request.grid);
  const auto backbone = geometry.backbone.make(ParameterPlacement{});
  fill(*backbone);
  const int64_t side = geometry.backbone.patch_side();
  const auto images = torch::randn({grid.views, 3, grid.height * side, grid.width * side});
  return seconds_of([&] { backbone->encode(images, geometry.backbone.levels() - 1); }) +
         geometry_seconds(geometry, grid, request.outputs.geometry_maps());
}

}  // namespace

double measure_stage_seconds(const SamplingStage& stage, const BundleOptions& bundle,
                             const PlanRequest& request) {
  const torch::NoGradGuard no_gradients;
  const StageRequest stages = request.stage_request();
  switch (stage.kind) {
    case StageKind::kSourceEncoding:
      return encoding_seconds(bundle, request);
    case StageKind::kSourceDepth:
      if (!uses_source_depth(bundle.level_set(), stages)) return 0;
      return source_geometry_seconds(bundle, request) +
             (mends_source_depth(bundle.level_set(), stages) ? depth_refinement_seconds(bundle, request) : 0);
    case StageKind::kSourceWarp:
      if (!needs_source_depth(bundle.level_set(), stages)) return 0;
      return (has_source_depth_stage(bundle.level_set(), stages) ? 0
                                                                 : source_geometry_seconds(bundle, request)) +
             warp_encoding_seconds(bundle, request);
    case StageKind::kComposition:
      return stages.photographs.blends() ? blending_seconds(bundle, request) : 0;
    case StageKind::kFlow:
      break;
    case StageKind::kSampleRefinement:
      return sample_refinement_seconds(bundle, request);
    case StageKind::kPropagation:
      return propagation_seconds(bundle, request);
    case StageKind::kRgbDecoding:
      return decoding_seconds(bundle, with_views(request.grid, stages.decoded_views(stages.image_views)));
    case StageKind::kGeometry:
      if (request.geometry_model) return geometry_model_seconds(*request.geometry_model, bundle, request);
      return geometry_seconds(bundle, with_views(request.grid, stages.decoded_views(stages.geometry_views)),
                              request.outputs.geometry_maps());
  }
  return 0;
}

}  // namespace gld
