#include "infer/pipeline/sampling_pipeline.h"

#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "infer/pipeline/visible_pairs.h"
#include "models/dit/extrapolated_field.h"
#include "models/dit/node_field.h"
#include "models/layers/imagenet.h"

#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

// What the source images say: patch tokens of levels 0 and 1, and the class token that propagation gives to every
// view.
struct SourceFeatures {
  LatentGrid grid;            // of all views
  torch::Tensor level0;       // (sources, tokens, channels) raw
  torch::Tensor level1;       // (sources, tokens, channels) raw
  torch::Tensor class_token;  // (1, 1, channels) raw: the first source view encoded alone
  // All levels as the DPT head takes them; only where needs_source_depth.
  std::vector<torch::Tensor> decodable;
};

void require_finite(const torch::Tensor& tensor, const std::string& stage, const std::string& what) {
  if (tensor.isfinite().all().item<bool>()) return;
  fail({stage, "finite numbers", "NaN or infinity in the " + what,
        "check the input images and cameras, and verify the weights with gld verify"});
}

torch::Tensor patches_of(const torch::Tensor& level) { return level.slice(1, 1).contiguous(); }

// One source view would leave the unit of its depth open.
bool needs_source_depth(const PipelineRequest& request) {
  return request.approximate.view_pairs == ViewPairs::kVisible && request.views.num_sources > 1;
}

SourceFeatures encode_sources(const PipelineModels& models, const PipelineRequest& request) {
  const auto backbone = models.backbone();
  const auto images = imagenet_normalise(request.source_images.to(request.device));
  const auto last_level = static_cast<int64_t>(backbone->options().out_layers.size()) - 1;
  const auto levels = backbone->encode(images, needs_source_depth(request) ? last_level : 1);
  SourceFeatures features;
  features.grid = backbone->options().grid_of(request.views.size(), images.size(2), images.size(3));
  features.level0 = patches_of(levels[0]);
  features.level1 = patches_of(levels[1]);
  // With one source view the joint encoding is the view alone already.
  const auto alone = request.views.num_sources == 1 ? levels : backbone->encode(images.slice(0, 0, 1), 1);
  features.class_token = alone[1].slice(0, 0, 1).slice(1, 0, 1).contiguous();
  if (needs_source_depth(request)) {
    for (const auto& level : levels) features.decodable.push_back(backbone->decodable(level).patches);
  }
  require_finite(features.level0, "source encoding", "level 0 features");
  require_finite(features.level1, "source encoding", "level 1 features");
  return features;
}

VisiblePairs find_visible_pairs(const PipelineModels& models, const PipelineRequest& request,
                                const SourceFeatures& sources) {
  if (sources.decodable.empty()) return visible_pairs(request.views);
  LatentGrid grid = sources.grid;
  grid.views = request.views.num_sources;
  return visible_pairs(request.views,
                       models.dpt_head()->forward(sources.decodable, grid, GeometryMaps::kDepthAndRays));
}

struct FlowStage {
  std::string name;
  SolverOptions solver;
  torch::Tensor noise;
};

// The field that the approximate savings ask for; with none of them the exact one.
std::unique_ptr<DitField> make_field(const DitDh& model, DitScene scene, const FlowStage& stage,
                                     const PipelineRequest& request) {
  const auto& savings = request.approximate;
  const bool cascade = model.options().conditioning == DitConditioning::kDeeperLevel;
  if (cascade && savings.cascade_encoder_nodes > 0) {
    auto nodes = encoder_nodes(stage.solver, request.guidance, savings.cascade_encoder_nodes);
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
  const auto branches = choose_branches(request.guidance, model.options(), scene.grid);
  const auto field = make_field(model, std::move(scene), stage, request);
  field->set_batched(branches.batched);
  GuidedField guided(*field, request.guidance);
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
  report.times = solved.times;
  report.evaluations = solved.evaluations;
  report.rejected = solved.rejected;
  report.guidance = guided.report();
  report.branches = branches;
  report.counts = field->counts();
  result.flows.push_back(std::move(report));
  return solved.state;
}

// Propagation attends over all views, so all take part whatever is decoded.
std::array<torch::Tensor, 4> propagate(const PipelineModels& models, const LatentGrid& grid,
                                       const torch::Tensor& class_token, const torch::Tensor& level1,
                                       const torch::Tensor& level0) {
  const auto backbone = models.backbone();
  PropagationStart start;
  start.level = 1;
  start.grid = grid;
  start.tokens = torch::cat({class_token.expand({grid.views, 1, class_token.size(2)}),
                             models.level1_statistics.denormalise(level1)},
                            1);
  const auto deeper = backbone->propagate(start);
  std::array<torch::Tensor, 4> levels;
  levels[0] = backbone->normalise_for_decoding(models.level0_statistics.denormalise(level0));
  for (size_t level = 1; level < levels.size(); ++level) {
    levels[level] = deeper.at(level - 1).patches;
    require_finite(levels[level], "propagation", fmt::format("level {} features", level));
  }
  return levels;
}

// The levels of the views to decode, and their grid.
struct DecodableViews {
  std::vector<torch::Tensor> levels;
  LatentGrid grid;
};

DecodableViews select_views(const PipelineResult& result, DecodedViews which, int64_t num_sources) {
  const int64_t first = which == DecodedViews::kTargets ? num_sources : 0;
  DecodableViews selected;
  selected.grid = result.grid;
  selected.grid.views = result.grid.views - first;
  for (const auto& level : result.levels) selected.levels.push_back(level.slice(0, first).contiguous());
  return selected;
}

void check_request(const PipelineRequest& request, const LatentGrid& grid) {
  const auto expect_noise = [&](const torch::Tensor& noise, const char* name) {
    if (noise.dim() == 3 && noise.size(0) == grid.views && noise.size(1) == grid.tokens_per_view()) return;
    fail({name, fmt::format("noise of shape ({}, {}, channels)", grid.views, grid.tokens_per_view()),
          c10::str(noise.sizes()), "draw it for these views"});
  };
  expect_noise(request.level1_noise, "level 1");
  expect_noise(request.level0_noise, "level 0");
}

}  // namespace

PipelineResult run_pipeline(const PipelineModels& models, const PipelineRequest& request,
                            StageRecords& stages) {
  const torch::NoGradGuard no_gradients;
  PipelineResult result;
  SourceFeatures sources;
  stages.run("source encoding", [&] { sources = encode_sources(models, request); });
  result.grid = sources.grid;
  check_request(request, result.grid);

  DitSceneInputs scene;
  scene.views = request.views;
  if (request.approximate.view_pairs == ViewPairs::kVisible) {
    stages.run("view pairs", [&] {
      const VisiblePairs pairs = find_visible_pairs(models, request, sources);
      scene.view_mask = pairs.view_mask();
      result.view_pairs = pairs.visibility;
      result.warnings = pairs.warnings;
    });
    sources.decodable.clear();
  }
  torch::Tensor level1, level0;
  stages.run("M1", [&] {
    const auto model = models.level1();
    scene.source_features = models.level1_statistics.normalise(sources.level1);
    level1 = run_flow(*model, model->prepare_scene(scene, request.savings),
                      {"M1", request.level1_solver, request.level1_noise}, request, result);
  });
  stages.run("cascade", [&] {
    const auto model = models.cascade();
    scene.source_features = models.level0_statistics.normalise(sources.level0);
    scene.deeper_level = level1;
    level0 = run_flow(*model, model->prepare_scene(scene, request.savings),
                      {"cascade", request.cascade_solver, request.level0_noise}, request, result);
  });
  result.level1 = level1.cpu();
  result.level0 = level0.cpu();
  const bool images = request.image_views != DecodedViews::kNone;
  const bool geometry = request.geometry_views != DecodedViews::kNone;
  if (!images && !geometry) return result;

  stop_if_interrupted("both latents were generated; nothing was decoded");
  stages.run("propagation",
             [&] { result.levels = propagate(models, result.grid, sources.class_token, level1, level0); });
  if (images) {
    stages.run("RGB decoding", [&] {
      const auto selected = select_views(result, request.image_views, request.views.num_sources);
      result.images =
          models.rgb_decoder()->decode(torch::cat(selected.levels, /*dim=*/2), selected.grid).cpu();
      require_finite(result.images, "RGB decoding", "images");
    });
    if (request.on_images) request.on_images(result.images);
  }
  if (geometry) {
    stop_if_interrupted("images were decoded; depth and rays were not");
    stages.run("geometry", [&] {
      const auto selected = select_views(result, request.geometry_views, request.views.num_sources);
      result.geometry = models.dpt_head()->forward(selected.levels, selected.grid, request.geometry_maps);
    });
  }
  return result;
}

}  // namespace gld
