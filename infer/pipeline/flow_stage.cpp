#include "infer/pipeline/flow_stage.h"

#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/flow/flow.h"
#include "infer/pipeline/level_decoding.h"
#include "models/conditioning/level_conditioning.h"
#include "models/dit/node_field.h"

#include <memory>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

struct FlowStage {
  std::string name;
  LevelGenerator generator;
  SolverOptions solver;
  torch::Tensor noise;
};

// Returns the field that the approximate savings ask for; with none of them it is the exact one.
std::unique_ptr<DitField> make_field(const DitDh& model, DitScene scene, const FlowStage& stage,
                                     const PipelineRequest& request) {
  const auto& savings = request.flow.approximate;
  const bool cascade = model.options().conditioning == DitConditioning::kDeeperLevel;
  if (cascade && savings.cascade_encoder_nodes > 0) {
    auto nodes = encoder_nodes(stage.solver, request.flow.guidance, savings.cascade_encoder_nodes);
    return std::make_unique<NodeField>(model, std::move(scene), std::move(nodes));
  }
  return std::make_unique<DitField>(model, std::move(scene));
}

// Says after which steps a preview is due: the first and then every so many evaluations.
class PreviewTimes {
 public:
  explicit PreviewTimes(int64_t every) : every_(every), next_(every) {}
  bool due(int64_t evaluations) {
    if (every_ <= 0 || evaluations < next_) return false;
    next_ += (evaluations - next_) / every_ * every_ + every_;
    return true;
  }

 private:
  int64_t every_, next_;
};

// preview takes the flow's prediction.
torch::Tensor run_flow(const DitDh& model, DitScene scene, const FlowStage& stage,
                       const PipelineRequest& request,
                       const std::function<void(const torch::Tensor&)>& preview, PipelineResult& result) {
  result.warnings.insert(result.warnings.end(), scene.warnings().begin(), scene.warnings().end());
  const auto branches = choose_branches(request.flow.guidance, model.options(), scene.grid);
  const auto field = make_field(model, std::move(scene), stage, request);
  field->set_batched(branches.batched);
  GuidedField guided(*field, request.flow.guidance);
  const auto times = solver_times(stage.solver);
  if (!is_adaptive(stage.solver.solver)) field->prepare_times({times.begin(), times.end() - 1});
  SolveObserver observer;
  observer.stage = stage.name;
  PreviewTimes previews(request.on_preview ? request.preview_every : 0);
  observer.on_step = [&](const SolveProgress& progress) {
    if (request.on_step) request.on_step(stage.name, progress);
    if (request.stop_asked()) return SolveDecision::kStop;  // before a preview is decoded
    if (progress.time > 0 && previews.due(progress.evaluations)) preview(progress.predicted_data());
    return SolveDecision::kGoOn;
  };
  observer.before_evaluation = [&] {
    return request.stop_asked() ? SolveDecision::kStop : SolveDecision::kGoOn;
  };
  if (request.on_step) {
    SolveProgress start;
    start.steps = is_adaptive(stage.solver.solver) ? 0 : static_cast<int64_t>(times.size()) - 1;
    request.on_step(stage.name, start);
  }
  const auto solved = solve_on(guided, stage.noise.to(request.device), stage.solver, times, observer);
  if (solved.stopped) {
    const auto done =
        fmt::format("{}: {} steps to flow time {:.4g}", stage.name, solved.accepted, solved.times.back());
    stop_if_interrupted(done);
    throw Interrupted(done);
  }
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

// Returns the same models with a backbone and a decoder that stay in memory once they are asked for.
PipelineModels loaded_once(const PipelineModels& models) {
  PipelineModels kept = models;
  const auto backbone = std::make_shared<std::shared_ptr<Backbone>>();
  kept.backbone = [backbone, load = models.backbone] { return *backbone ? *backbone : *backbone = load(); };
  const auto decoder = std::make_shared<std::shared_ptr<ImageDecoder>>();
  kept.rgb_decoder = [decoder, load = models.rgb_decoder] { return *decoder ? *decoder : *decoder = load(); };
  return kept;
}

// Returns the target views as they would be if the flow of this level ended with this prediction.
torch::Tensor preview_images(const PipelineModels& models, const PipelineRequest& request,
                             const PipelineState& state, const LatentGrid& grid, int64_t level,
                             const torch::Tensor& predicted) {
  PipelineState present;
  present.sources = state.sources;
  for (size_t i = 0; i < models.levels.generators.size(); ++i) {
    const int64_t other = models.levels.generators[i].level;
    const auto made = state.latents.find(other);
    const bool known = made != state.latents.end() && made->second.defined();
    present.latents[other] = known ? made->second : torch::zeros_like(request.noise[i]).to(request.device);
  }
  present.latents[level] = predicted;
  const std::string stage = "preview";
  const auto levels = complete_levels(models, present, grid, stage).patches;
  return decoded_images(models, select_views(levels, grid, DecodedViews::kTargets, request.views.num_sources),
                        stage);
}

}  // namespace

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
  DitSceneInputs shown = condition_on_source_level({generator.level, model->options(), statistics},
                                                   request.views, state.sources);
  if (generator.is_cascade()) condition_on_deeper_level(shown, state.latents.at(*generator.deeper));
  SolverOptions solver = request.flow.solvers[stage.generator];
  solver.schedule.shift =
      resolved_time_shift(solver.schedule.shift, result.grid, model->options().in_channels);
  const PipelineModels kept = loaded_once(models);
  const auto preview = [&](const torch::Tensor& predicted) {
    request.on_preview(stage.name,
                       preview_images(kept, request, state, result.grid, generator.level, predicted));
  };
  auto& latent = state.latents[generator.level];
  latent =
      run_flow(*model, model->prepare_scene(shown, request.savings),
               {stage.name, generator, solver, request.noise[stage.generator]}, request, preview, result);
  result.latents[generator.level] = latent.cpu();
  if (request.on_latent) request.on_latent(generator.level, result.latents[generator.level]);
}

}  // namespace gld
