#include "infer/pipeline/sampling_pipeline.h"

#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/flow/flow.h"
#include "infer/pipeline/geometry_of_pictures.h"
#include "infer/pipeline/visible_pairs.h"
#include "models/dit/extrapolated_field.h"
#include "models/dit/node_field.h"
#include "models/latent_spaces/geometric_latent_space.h"
#include "models/scene_geometry/source_warp.h"

#include <map>
#include <optional>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

void require_finite(const torch::Tensor& tensor, const std::string& stage, const std::string& what) {
  if (tensor.isfinite().all().item<bool>()) return;
  fail({stage, "finite numbers", "NaN or infinity in the " + what,
        "check the input images and cameras, and verify the weights with gld verify"});
}

// What the source images say.
struct EncodedSources {
  SourceLatents latents;
  GeometryInputs decodable;  // what the geometry head takes; empty where nobody asks for their depth
  std::optional<GeometryOutput> geometry;  // what it says, from the first stage that asked
};

EncodedSources encode_sources(const LatentSpace& space, const LevelSet& levels,
                              const PipelineRequest& request, const std::string& stage) {
  const StageRequest stages = request.stage_request();
  SourceEncoding wanted;
  wanted.deepest = deepest_encoded_level(levels, stages);
  wanted.carried = stages.decodes();
  EncodedSources sources;
  sources.latents = space.encode_sources(request.source_images.to(request.device), wanted);
  if (uses_source_depth(levels, stages)) sources.decodable = geometry_inputs(space, sources.latents);
  for (const auto& generator : levels.generators) {
    require_finite(sources.latents.levels[static_cast<size_t>(generator.level)], stage,
                   fmt::format("level {} features", generator.level));
  }
  // Deeper levels than the generated ones are not needed any more.
  sources.latents.levels.resize(static_cast<size_t>(levels.deepest_generated()) + 1);
  return sources;
}

// Depth and rays of the source views by themselves; null for one of them, whose depth has no scale.
const GeometryOutput* source_geometry(const PipelineModels& models, EncodedSources& sources) {
  if (sources.decodable.levels.empty()) return nullptr;
  if (!sources.geometry) {
    sources.geometry =
        models.dpt_head()->forward(sources.decodable, sources.latents.grid, GeometryMaps::kDepthAndRays);
  }
  return &*sources.geometry;
}

VisiblePairs find_visible_pairs(const PipelineModels& models, const PipelineRequest& request,
                                EncodedSources& sources) {
  const GeometryOutput* geometry = source_geometry(models, sources);
  return geometry == nullptr ? visible_pairs(request.views)
                             : visible_pairs(request.views, *geometry, request.source_images);
}

CarriedSources carry_sources(const PipelineModels& models, const PipelineRequest& request,
                             EncodedSources& sources, std::vector<std::string>& warnings) {
  const GeometryOutput* geometry = source_geometry(models, sources);
  if (geometry == nullptr) return {};  // one source: the plan says so
  const GeometricLatentSpace space(models.backbone(), models.levels.boundary);
  CarriedSources carried =
      carry_sources(space, request.views, request.source_images.to(request.device), *geometry,
                    {models.levels.warped_sources, models.levels.deepest_generated()});
  if (!carried.doubt.empty()) {
    warnings.push_back(
        "The model was not shown the source photographs in the target views, as it is trained to be: " +
        carried.doubt + ".");
  }
  return carried;
}

struct FlowStage {
  std::string name;
  LevelGenerator generator;
  SolverOptions solver;
  torch::Tensor noise;
};

// The field that the approximate savings ask for; with none of them the exact one.
std::unique_ptr<DitField> make_field(const DitDh& model, DitScene scene, const FlowStage& stage,
                                     const PipelineRequest& request) {
  const auto& savings = request.flow.approximate;
  const bool cascade = model.options().conditioning == DitConditioning::kDeeperLevel;
  if (cascade && savings.cascade_encoder_nodes > 0) {
    auto nodes = encoder_nodes(stage.solver, request.flow.guidance, savings.cascade_encoder_nodes);
    return std::make_unique<NodeField>(model, std::move(scene), std::move(nodes));
  }
  if (!cascade && savings.level1_encoder_every > 1) {
    return std::make_unique<ExtrapolatedField>(model, std::move(scene), savings.level1_encoder_every);
  }
  return std::make_unique<DitField>(model, std::move(scene));
}

torch::Tensor run_flow(const DitDh& model, DitScene scene, const FlowStage& stage,
                       const PipelineRequest& request, PipelineResult& result) {
  result.warnings.insert(result.warnings.end(), scene.warnings().begin(), scene.warnings().end());
  const auto branches = choose_branches(request.flow.guidance, model.options(), scene.grid);
  const auto field = make_field(model, std::move(scene), stage, request);
  field->set_batched(branches.batched);
  GuidedField guided(*field, request.flow.guidance);
  const auto times = solver_times(stage.solver);
  if (!is_adaptive(stage.solver.solver)) field->prepare_times({times.begin(), times.end() - 1});
  SolveObserver observer;
  observer.stage = stage.name;
  observer.on_step = [&](const SolveProgress& progress) {
    if (request.on_step) request.on_step(stage.name, progress);
  };
  if (request.on_step) {
    SolveProgress start;
    start.steps = is_adaptive(stage.solver.solver) ? 0 : static_cast<int64_t>(times.size()) - 1;
    request.on_step(stage.name, start);
  }
  const auto solved = solve_on(guided, stage.noise.to(request.device), stage.solver, times, observer);
  FlowReport report;
  report.stage = stage.name;
  report.generator = stage.generator;
  report.times = solved.times;
  report.evaluations = solved.evaluations;
  report.rejected = solved.rejected;
  report.guidance = guided.report();
  report.branches = branches;
  report.counts = field->counts();
  result.flows.push_back(std::move(report));
  return solved.state;
}

// The levels of the views to decode, and their grid.
struct DecodableViews {
  std::vector<torch::Tensor> levels;
  LatentGrid grid;
};

DecodableViews select_views(const PipelineResult& result, const std::vector<int64_t>& levels,
                            DecodedViews which, int64_t num_sources) {
  const int64_t first = which == DecodedViews::kTargets ? num_sources : 0;
  DecodableViews selected;
  selected.grid = result.grid;
  selected.grid.views = result.grid.views - first;
  for (const int64_t level : levels) {
    selected.levels.push_back(result.levels.at(static_cast<size_t>(level)).slice(0, first).contiguous());
  }
  return selected;
}

std::vector<int64_t> all_levels(const PipelineResult& result, const std::string& stage) {
  std::vector<int64_t> levels;
  for (size_t level = 0; level < result.levels.size(); ++level) {
    if (!result.levels[level].defined()) {
      fail({stage, "all levels, which the DPT head takes", fmt::format("no level {}", level),
            "ask for images alone, or use a model that generates it"});
    }
    levels.push_back(static_cast<int64_t>(level));
  }
  return levels;
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

// What the stages hand on to each other.
struct PipelineState {
  EncodedSources sources;
  DitSceneInputs scene;
  CarriedSources carried;
  std::map<int64_t, torch::Tensor> latents;  // normalised, on the device
};

void run_flow_stage(const PipelineModels& models, const PipelineRequest& request, const SamplingStage& stage,
                    PipelineState& state, PipelineResult& result) {
  const LevelGenerator& generator = models.levels.generators[stage.generator];
  const LevelStatistics& statistics = models.statistics[stage.generator];
  if (const auto kept = request.kept_latents.find(generator.level); kept != request.kept_latents.end()) {
    const auto& noise = request.noise[stage.generator];
    if (kept->second.sizes() != noise.sizes()) {
      fail({stage.name, "kept latents of shape " + c10::str(noise.sizes()), c10::str(kept->second.sizes()),
            "begin the run again with --overwrite"});
    }
    state.latents[generator.level] = kept->second.to(request.device);
    result.latents[generator.level] = kept->second;
    FlowReport report;
    report.stage = stage.name;
    report.generator = generator;
    report.kept = true;
    result.flows.push_back(std::move(report));
    return;
  }
  const auto model = models.generator(stage.generator);
  const auto& raw = state.sources.latents.levels[static_cast<size_t>(generator.level)];
  state.scene.source_features = statistics.normalise(
      generated_tokens(raw, raw.size(1) - result.grid.tokens_per_view(), statistics.special_tokens));
  state.scene.deeper_level = generator.is_cascade() ? state.latents.at(*generator.deeper) : torch::Tensor();
  set_warp(state.scene, model->options(), state.carried.agreement,
           state.carried.levels.empty()
               ? torch::Tensor()
               : statistics.normalise(state.carried.levels[static_cast<size_t>(generator.level)]));
  SolverOptions solver = request.flow.solvers[stage.generator];
  solver.schedule.shift =
      resolved_time_shift(solver.schedule.shift, result.grid, model->options().in_channels);
  auto& latent = state.latents[generator.level];
  latent = run_flow(*model, model->prepare_scene(state.scene, request.savings),
                    {stage.name, generator, solver, request.noise[stage.generator]}, request, result);
  result.latents[generator.level] = latent.cpu();
  if (request.on_latent) request.on_latent(generator.level, result.latents[generator.level]);
}

CompletedLevels complete_levels(const PipelineModels& models, const PipelineState& state,
                                const LatentGrid& grid, const std::string& stage) {
  const GeometricLatentSpace space(models.backbone(), models.levels.boundary);
  std::map<int64_t, torch::Tensor> raw;
  for (size_t i = 0; i < models.levels.generators.size(); ++i) {
    const int64_t level = models.levels.generators[i].level;
    raw[level] = models.statistics[i].denormalise(state.latents.at(level));
  }
  auto levels = space.complete(raw, state.sources.latents.carried, grid);
  for (size_t level = 0; level < levels.patches.size(); ++level) {
    if (levels.patches[level].defined())
      require_finite(levels.patches[level], stage, fmt::format("level {} features", level));
  }
  return levels;
}

// Depth and rays as another model sees them in the source images and the generated ones.
GeometryOutput geometry_of_images(const PipelineModels& models, const PipelineRequest& request,
                                  const PipelineResult& result, const std::string& stage) {
  if (!result.images.defined()) {
    fail({stage, "generated images, which the geometry model looks at", "none",
          "ask for images beside depth, rays or points"});
  }
  auto maps = geometry_of_pictures(models, torch::cat({request.source_images, result.images}),
                                   request.geometry_maps, request.device);
  if (request.geometry_views != DecodedViews::kTargets) return maps;
  for (torch::Tensor* map : {&maps.depth, &maps.depth_confidence, &maps.rays, &maps.ray_confidence,
                             &maps.points, &maps.point_confidence}) {
    if (map->defined()) *map = map->slice(0, request.views.num_sources);
  }
  return maps;
}

}  // namespace

StageRequest PipelineRequest::stage_request() const {
  StageRequest stages;
  stages.views = views.size();
  stages.num_sources = views.num_sources;
  stages.image_views = image_views;
  stages.geometry_views = geometry_views;
  stages.view_pairs = flow.approximate.view_pairs;
  return stages;
}

PipelineResult run_pipeline(const PipelineModels& models, const PipelineRequest& request,
                            StageRecords& stages) {
  const torch::NoGradGuard no_gradients;
  const int64_t num_sources = request.views.num_sources;
  PipelineResult result;
  PipelineState state;
  state.scene.views = request.views;
  const auto run = [&](const SamplingStage& stage) {
    switch (stage.kind) {
      case StageKind::kSourceEncoding: {
        const GeometricLatentSpace space(models.backbone(), models.levels.boundary);
        state.sources = encode_sources(space, models.levels, request, stage.name);
        result.grid = state.sources.latents.grid;
        result.grid.views = request.views.size();
        check_request(models, request, result.grid);
        return;
      }
      case StageKind::kViewPairs: {
        const VisiblePairs pairs = find_visible_pairs(models, request, state.sources);
        state.scene.view_mask = pairs.view_mask();
        result.view_pairs = pairs.visibility;
        result.warnings = pairs.warnings;
        return;
      }
      case StageKind::kSourceWarp:
        state.carried = carry_sources(models, request, state.sources, result.warnings);
        return;
      case StageKind::kFlow:
        state.sources.decodable = {};
        state.sources.geometry.reset();
        run_flow_stage(models, request, stage, state, result);
        return;
      case StageKind::kPropagation: {
        CompletedLevels levels = complete_levels(models, state, result.grid, stage.name);
        result.levels = std::move(levels.patches);
        result.leading = levels.leading;
        return;
      }
      case StageKind::kRgbDecoding: {
        const auto selected =
            select_views(result, models.levels.decoded_levels(), request.image_views, num_sources);
        result.images =
            models.rgb_decoder()->decode(torch::cat(selected.levels, /*dim=*/2), selected.grid).cpu();
        require_finite(result.images, stage.name, "images");
        return;
      }
      case StageKind::kGeometry: {
        if (models.geometry_backbone) {
          result.geometry = geometry_of_images(models, request, result, stage.name);
          require_finite_geometry(result.geometry, stage.name);
          return;
        }
        const auto selected =
            select_views(result, all_levels(result, stage.name), request.geometry_views, num_sources);
        result.geometry = models.dpt_head()->forward(GeometryInputs{selected.levels, result.leading},
                                                     selected.grid, request.geometry_maps);
        require_finite_geometry(result.geometry, stage.name);
        return;
      }
    }
  };
  for (const auto& stage : sampling_stages(models.levels, request.stage_request())) {
    if (!stage.runs) continue;
    if (stage.kind == StageKind::kPropagation) {
      stop_if_interrupted("the latents were generated; nothing was decoded");
    } else if (stage.kind == StageKind::kGeometry) {
      stop_if_interrupted("images were decoded; depth and rays were not");
    }
    stages.run(stage.name, [&] { run(stage); });
    if (stage.kind == StageKind::kRgbDecoding && request.on_images) request.on_images(result.images);
  }
  return result;
}

}  // namespace gld
