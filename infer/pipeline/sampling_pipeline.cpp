#include "infer/pipeline/sampling_pipeline.h"

#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/latents/latent_divergence.h"
#include "gld/tensors/tensor_pictures.h"
#include "infer/pipeline/flow_stage.h"
#include "infer/pipeline/geometry_of_pictures.h"
#include "infer/pipeline/level_decoding.h"
#include "infer/pipeline/pipeline_state.h"
#include "infer/pipeline/sample_refinement.h"
#include "infer/pipeline/used_source_depth.h"
#include "models/conditioning/decoder_inputs.h"
#include "models/conditioning/source_conditioning.h"
#include "models/latent_spaces/latent_space.h"
#include "models/scene_geometry/source_warp.h"

#include <algorithm>
#include <map>
#include <optional>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

void run_source_encoding(const PipelineModels& models, const PipelineRequest& request, PipelineState& state,
                         const std::string& stage) {
  const LatentSpace space(models.backbone(), models.levels.boundary);
  state.sources = encode_sources(space, request.source_images.to(request.device),
                                 conditioning_needs(models.levels, request.stage_request()));
  for (const auto& generator : models.levels.generators) {
    require_finite(state.sources.levels[static_cast<size_t>(generator.level)], stage,
                   fmt::format("level {} features", generator.level));
  }
}

// Returns how far the source views are from what each generator was trained on, by their patch tokens.
std::vector<double> source_divergences(const PipelineModels& models, const SourceConditioning& sources) {
  std::vector<double> divergences;
  for (size_t i = 0; i < models.levels.generators.size(); ++i) {
    const auto& level = sources.levels[static_cast<size_t>(models.levels.generators[i].level)];
    const int64_t leading = level.size(1) - sources.grid.tokens_per_view();
    divergences.push_back(latent_divergence(level.slice(1, leading), models.statistics[i].patches));
  }
  return divergences;
}

const SourcePhotographs& photographs_of(const PipelineRequest& request, PipelineState& state) {
  if (!request.source_photographs.views.empty()) return request.source_photographs;
  if (state.photographs.views.empty())
    state.photographs = photographs_of_images(request.views, request.source_images);
  return state.photographs;
}

// Returns what the geometry head says of the source views alone; nothing where it is not asked.
std::optional<GeometryOutput> head_geometry(const PipelineModels& models, const PipelineState& state) {
  if (state.sources.for_geometry.levels.empty()) return std::nullopt;
  return source_geometry(*models.geometry_head(), state.sources);
}

void run_source_depth(const PipelineModels& models, const PipelineRequest& request, PipelineState& state,
                      PipelineResult& result) {
  if (state.depth) return;
  const auto head = head_geometry(models, state);
  PhotographDepth found =
      used_source_depth(models, request.photographs, request.views, request.source_images,
                        photographs_of(request, state), head ? &*head : nullptr, request.single_source_unit);
  state.depth = std::move(found.depth);
  result.stereo = std::move(found.stereo);
  result.head_depth = std::move(found.head);
  if (request.views.num_sources == 1) {
    result.head_depth_log_deviation = head && head->single_view ? head->single_view->unit->log_deviation
                                                                : request.single_source_unit_deviation;
  }
}

void run_source_warp(const PipelineModels& models, const PipelineRequest& request, PipelineState& state,
                     PipelineResult& result) {
  if (!needs_source_depth(models.levels, request.stage_request())) return;  // the plan says why
  if (!state.depth) run_source_depth(models, request, state, result);       // without a stage of its own
  const SourceScene scene{request.views, request.source_images.to(request.device), state.depth};
  const LatentSpace space(models.backbone(), models.levels.boundary);
  state.sources.warped =
      warp_into_targets(space, scene, conditioning_needs(models.levels, request.stage_request()));
  const std::string& doubt = state.sources.warped.doubt;
  if (!doubt.empty()) {
    result.warnings.push_back(
        "The model was not shown the source photographs in the target views, as it is trained to be: " +
        doubt + ".");
  }
}

// The result is null where photographs are laid together by rule.
std::shared_ptr<PhotographBlending> blending_of(const PipelineModels& models,
                                                const PipelineRequest& request) {
  return request.photographs.blends() ? models.blending() : nullptr;
}

void run_composition(const PipelineModels& models, const PipelineRequest& request, PipelineState& state,
                     PipelineResult& result) {
  if (!state.depth || !state.depth->known()) {
    result.warnings.push_back("Nothing of the source photographs is kept in the target views: " +
                              (state.depth ? state.depth->doubt : std::string("their depth is not known")) +
                              ".");
    return;
  }
  const int64_t sources = result.images.size(0) - request.views.num_targets();  // where those are decoded too
  const auto targets = result.images.slice(0, sources);
  result.composed = compose_views(request.views, photographs_of(request, state), *state.depth, targets,
                                  blending_of(models, request).get());
  result.generated_images = result.images;
  result.images = torch::cat({result.images.slice(0, 0, sources), result.composed->images});
}

void require_all_levels(const std::vector<torch::Tensor>& levels, const std::string& stage) {
  for (size_t level = 0; level < levels.size(); ++level) {
    if (levels[level].defined()) continue;
    fail({stage, "all levels, which the DPT head takes", fmt::format("no level {}", level),
          "ask for images alone, or use a model that generates it"});
  }
}

void check_request(const PipelineModels& models, const PipelineRequest& request, const LatentGrid& grid) {
  const auto& generators = models.levels.generators;
  if (request.noise.size() != generators.size() || request.flow.solvers.size() != generators.size()) {
    fail({"sampling", fmt::format("noise and a solver for each of {} generated levels", generators.size()),
          fmt::format("{} and {}", request.noise.size(), request.flow.solvers.size()),
          "make them from the bundle"});
  }
  for (size_t i = 0; i < generators.size(); ++i) {
    const int64_t tokens = grid.tokens_per_view() + models.statistics.at(i).special_tokens;
    const auto& noise = request.noise[i];
    if (noise.dim() == 3 && noise.size(0) == grid.views && noise.size(1) == tokens) continue;
    fail({level_noise_stream(generators[i].level),
          fmt::format("noise of shape ({}, {}, channels)", grid.views, tokens), c10::str(noise.sizes()),
          "draw it for these views"});
  }
}

// Returns depth and rays as another model sees them in the source images and the generated ones.
GeometryOutput geometry_of_images(const PipelineModels& models, const PipelineRequest& request,
                                  const PipelineResult& result, const std::string& stage) {
  if (!result.images.defined()) {
    fail({stage, "generated images, which the geometry model looks at", "none",
          "ask for images beside depth, rays or points"});
  }
  const bool given = request.geometry_cameras == GeometryCameras::kGiven;
  auto maps =
      geometry_of_pictures(models, torch::cat({request.source_images, result.images}), request.geometry_maps,
                           request.device, given ? request.views.cameras : std::vector<Camera>());
  if (request.geometry_views != DecodedViews::kTargets) return maps;
  for (torch::Tensor* map : {&maps.depth, &maps.depth_confidence, &maps.rays, &maps.ray_confidence,
                             &maps.points, &maps.point_confidence, &maps.camera_encodings}) {
    if (map->defined()) *map = map->slice(0, request.views.num_sources);
  }
  return maps;
}

// Depth is fused with what the photographs agree on, where they were matched.
void fuse_depth(const PipelineRequest& request, const PipelineState& state, PipelineResult& result) {
  if (!result.stereo || !state.depth || !state.depth->known() || !result.geometry.depth.defined()) return;
  result.view_depth = fused_view_depths(request.views, request.source_images, *state.depth, *result.stereo,
                                        result.geometry.depth);
  result.view_depth_from = "photographs and geometry head";
  if (request.photographs.refines()) result.view_depth_from += ", mended by a network";
}

// Returns which views are there without some target views (numbers from 0, of targets).
std::vector<int64_t> views_without(const Views& views, const std::vector<int64_t>& left_out) {
  std::vector<int64_t> kept;
  for (int64_t view = 0; view < views.size(); ++view) {
    if (!std::binary_search(left_out.begin(), left_out.end(), view - views.num_sources)) kept.push_back(view);
  }
  return kept;
}

Views chosen_views(const Views& views, const std::vector<int64_t>& kept) {
  Views chosen = views;
  chosen.cameras.clear();
  for (const int64_t view : kept) chosen.cameras.push_back(views.cameras[static_cast<size_t>(view)]);
  return chosen;
}

// Returns the request without some of its target views, for what is generated of the others: their pictures.
PipelineRequest without_targets(const PipelineRequest& request, const std::vector<int64_t>& left_out,
                                const SourceDepth& depth) {
  PipelineRequest rest = request;
  const std::vector<int64_t> kept = views_without(request.views, left_out);
  rest.views = chosen_views(request.views, kept);
  const auto index = torch::tensor(kept);
  for (torch::Tensor& noise : rest.noise) noise = noise.index_select(0, index.to(noise.device()));
  rest.source_depth = depth;
  rest.photographs.leaves_out_complete = false;
  rest.geometry_views = DecodedViews::kNone;
  rest.on_images = nullptr;
  return rest;
}

// Takes rows of `some` at the places that `numbers` name, and of `others` in order at the other places.
torch::Tensor merged(const torch::Tensor& some, const std::vector<int64_t>& numbers,
                     const torch::Tensor& others) {
  std::vector<torch::Tensor> rows;
  int64_t taken = 0, other = 0;
  const auto count = some.size(0) + (others.defined() ? others.size(0) : 0);
  for (int64_t row = 0; row < count; ++row) {
    const bool is_some = std::binary_search(numbers.begin(), numbers.end(), row);
    rows.push_back(is_some ? some[taken++] : others[other++]);
  }
  return torch::stack(rows);
}

PipelineResult run_stages(const PipelineModels& models, const PipelineRequest& request, PipelineState& state,
                          StageRecords& stages);

// Of some target views the photographs say all, so that flows are run for the others alone, if any: fills in what is
// left of the result. composition is the name of that stage.
void run_without_complete(const PipelineModels& models, const PipelineRequest& request, PipelineState& state,
                          const std::vector<int64_t>& complete, const std::string& composition,
                          PipelineResult& result, StageRecords& stages) {
  std::vector<int64_t> others;
  for (int64_t target = 0; target < request.views.num_targets(); ++target) {
    if (!std::binary_search(complete.begin(), complete.end(), target)) others.push_back(target);
  }
  const Views carried = chosen_views(request.views, views_without(request.views, others));
  ComposedViews composed;
  stages.run(others.empty() ? composition : composition + " of complete views", [&] {
    composed = carried_views(carried, photographs_of(request, state), *state.depth,
                             blending_of(models, request).get());
  });
  state.sources.for_geometry = {};
  if (!others.empty()) {
    PipelineRequest of_others = without_targets(request, complete, *state.depth);
    if (request.on_preview) {
      of_others.on_preview = [&](const std::string& stage, const torch::Tensor& images) {
        request.on_preview(stage, merged(composed.images, complete, images));
      };
    }
    PipelineResult rest = run_stages(models, of_others, state, stages);
    composed.images = merged(composed.images, complete, rest.composed->images);
    composed.shown = merged(composed.shown, complete, rest.composed->shown);
    composed.expected_variance =
        merged(composed.expected_variance, complete, rest.composed->expected_variance);
    composed.large_images = merged(composed.large_images, complete, rest.composed->large_images);
    composed.large_shown = merged(composed.large_shown, complete, rest.composed->large_shown);
    result.grid = rest.grid;
    result.latents = std::move(rest.latents);
    result.levels = std::move(rest.levels);
    result.leading = rest.leading;
    result.flows = std::move(rest.flows);
    result.refined = rest.refined;
    result.warnings.insert(result.warnings.end(), rest.warnings.begin(), rest.warnings.end());
  }
  result.carried_only = complete;
  result.images = composed.images;
  result.composed = std::move(composed);
  if (request.on_images) request.on_images(result.images, result.composed);
  if (request.geometry_views == DecodedViews::kNone) return;
  const std::string name = "geometry";
  stages.run(name, [&] {
    result.geometry = geometry_of_images(models, request, result, name);
    require_finite_geometry(result.geometry, name);
    fuse_depth(request, state, result);
  });
}

// Goes on from the sources where the state has them encoded, with their depth.
PipelineResult run_stages(const PipelineModels& models, const PipelineRequest& request, PipelineState& state,
                          StageRecords& stages) {
  const int64_t num_sources = request.views.num_sources;
  PipelineResult result;
  const auto take_grid = [&] {
    result.grid = state.sources.grid;
    result.grid.views = request.views.size();
    check_request(models, request, result.grid);
  };
  const bool encoded = !state.sources.levels.empty();
  if (encoded) take_grid();
  const auto run = [&](const SamplingStage& stage) {
    switch (stage.kind) {
      case StageKind::kSourceEncoding:
        run_source_encoding(models, request, state, stage.name);
        result.divergences = source_divergences(models, state.sources);
        take_grid();
        return;
      case StageKind::kSourceDepth:
        run_source_depth(models, request, state, result);
        return;
      case StageKind::kSourceWarp:
        run_source_warp(models, request, state, result);
        return;
      case StageKind::kFlow:
        state.sources.for_geometry = {};
        run_flow_stage(models, request, stage, state, result);
        return;
      case StageKind::kSampleRefinement:
        run_sample_refinement(models, request, stage.name, state, result);
        return;
      case StageKind::kPropagation: {
        CompletedLevels levels = complete_levels(models, state, result.grid, stage.name);
        result.levels = std::move(levels.patches);
        result.leading = levels.leading;
        return;
      }
      case StageKind::kRgbDecoding: {
        const auto selected = select_views(result.levels, result.grid, request.image_views, num_sources);
        result.images = decoded_images(models, selected, stage.name);
        return;
      }
      case StageKind::kComposition:
        run_composition(models, request, state, result);
        return;
      case StageKind::kGeometry: {
        if (models.geometry_model_backbone) {
          result.geometry = geometry_of_images(models, request, result, stage.name);
          require_finite_geometry(result.geometry, stage.name);
          fuse_depth(request, state, result);
          return;
        }
        require_all_levels(result.levels, stage.name);
        const auto selected = select_views(result.levels, result.grid, request.geometry_views, num_sources);
        result.geometry = models.geometry_head()->forward(GeometryInputs{selected.levels, result.leading},
                                                          selected.grid, request.geometry_maps);
        require_finite_geometry(result.geometry, stage.name);
        fuse_depth(request, state, result);
        return;
      }
    }
  };
  const auto planned = sampling_stages(models.levels, request.stage_request());
  const auto composition = std::find_if(planned.begin(), planned.end(), [](const SamplingStage& stage) {
    return stage.kind == StageKind::kComposition && stage.runs;
  });
  const bool composes = composition != planned.end();
  const bool may_leave_out = composes && request.photographs.leaves_out_complete && !request.all_latents &&
                             request.image_views == DecodedViews::kTargets;
  const StageKind last_image_stage = composes ? StageKind::kComposition : StageKind::kRgbDecoding;
  for (const auto& stage : planned) {
    if (!stage.runs) continue;
    if (encoded && (stage.kind == StageKind::kSourceEncoding || stage.kind == StageKind::kSourceDepth))
      continue;
    if (stage.kind == StageKind::kPropagation) {
      stop_if_interrupted("the latents were generated; nothing was decoded");
    } else if (stage.kind == StageKind::kGeometry) {
      stop_if_interrupted("images were decoded; depth and rays were not");
    }
    // Ctrl-C waits for pictures that are decoded to be laid together and written; who asks in the program gets nothing.
    if (request.stop_requested && request.stop_requested()) throw Interrupted(stage.name + " was not begun");
    stages.run(stage.name, [&] { run(stage); });
    if (stage.kind == StageKind::kSourceDepth && may_leave_out) {
      std::vector<int64_t> complete;
      stages.run("complete views", [&] {
        complete = complete_targets(request.views, photographs_of(request, state), *state.depth);
      });
      if (!complete.empty()) {
        run_without_complete(models, request, state, complete, composition->name, result, stages);
        return result;
      }
    }
    if (stage.kind == last_image_stage && request.on_images)
      request.on_images(result.images, result.composed);
  }
  return result;
}

}  // namespace

bool PipelineRequest::stop_asked() const {
  return interrupt_requested() || (stop_requested && stop_requested());
}

StageRequest PipelineRequest::stage_request() const {
  StageRequest stages;
  stages.views = views.size();
  stages.num_sources = views.num_sources;
  stages.image_views = image_views;
  stages.geometry_views = geometry_views;
  stages.source_depth_given = source_depth.has_value();
  stages.single_source_unit_known = single_source_unit > 0;
  stages.photographs = photographs;
  stages.refines_samples = flow.refine;
  return stages;
}

PipelineResult run_pipeline(const PipelineModels& models, const PipelineRequest& request,
                            StageRecords& stages) {
  const torch::NoGradGuard no_gradients;
  PipelineState state;
  state.depth = request.source_depth;
  return run_stages(models, request, state, stages);
}

}  // namespace gld
