#include "infer/sampling.h"

#include "datasets/batching.h"
#include "datasets/scene_reader.h"
#include "gld/configuration.h"
#include "gld/error.h"
#include "gld/interrupt.h"
#include "gld/progress.h"
#include "gld/random.h"
#include "gld/run_folder.h"
#include "gld/torch_version.h"
#include "infer/bundle_models.h"
#include "infer/sampling_outputs.h"
#include "infer/sampling_plan.h"

#include <algorithm>
#include <iostream>
#include <memory>
#include <thread>

#include <fmt/format.h>

namespace gld {
namespace {

std::vector<TrainedSize> trained_sizes(const BundleOptions& options) {
  std::vector<TrainedSize> sizes;
  for (const auto& size : options.image_sizes()) sizes.push_back({size.width, size.height});
  return sizes;
}

torch::Tensor stacked(const std::vector<Image>& images) {
  std::vector<torch::Tensor> tensors;
  tensors.reserve(images.size());
  for (const auto& image : images) tensors.push_back(to_tensor(image));
  return torch::stack(tensors);
}

PipelineRequest make_request(const SampleOptions& options, const BundleOptions& bundle,
                             const SamplingScene& scene, const torch::Device& device) {
  const RequestedOutputs requested = options.requested();
  const LatentGrid grid = bundle.backbone.grid_of(scene.views.size(), scene.size.height, scene.size.width);
  PipelineRequest request;
  request.views = scene.views;
  request.source_images = stacked(scene.source_images);
  const auto noise = [&](const char* stream, int64_t channels) {
    return views_noise(static_cast<uint64_t>(options.seed), stream, grid.views,
                       {grid.tokens_per_view(), channels});
  };
  request.level1_noise = noise("level 1", bundle.level1.in_channels);
  request.level0_noise = noise("level 0", bundle.cascade.in_channels);
  request.level1_solver = options.resolved_solver(bundle.level1_time_shift.evaluation);
  request.cascade_solver = options.resolved_solver(bundle.cascade_time_shift.evaluation);
  request.guidance = options.guidance;
  request.savings = options.savings();
  request.image_views = requested.needs_image() ? DecodedViews::kTargets : DecodedViews::kNone;
  if (requested.needs_geometry()) {
    request.geometry_views = requested.points ? DecodedViews::kAll : DecodedViews::kTargets;
    request.geometry_maps = requested.needs_depth() && requested.needs_rays() ? GeometryMaps::kDepthAndRays
                            : requested.needs_depth()                         ? GeometryMaps::kDepth
                                                                              : GeometryMaps::kRays;
  }
  request.device = device;
  return request;
}

nlohmann::ordered_json flows_json(const std::vector<FlowReport>& flows) {
  auto list = nlohmann::ordered_json::array();
  for (const auto& flow : flows) {
    list.push_back({{"stage", flow.stage},
                    {"function_evaluations", flow.evaluations},
                    {"rejected_steps", flow.rejected},
                    {"with_unconditional_branch", flow.guidance.unconditional},
                    {"unconditional_dropped", flow.guidance.dropped},
                    {"largest_neglected_guidance", flow.guidance.largest_neglected},
                    {"branches_together", flow.counts.batched},
                    {"branch_choice", flow.branches.reason},
                    {"condition_encoder_runs", flow.counts.condition_encoder},
                    {"velocity_decoder_runs", flow.counts.velocity_decoder},
                    {"times", flow.times}});
  }
  return list;
}

std::string one_line_summary(const SampleOptions& options, const PipelineResult& result,
                             const std::string& model) {
  return fmt::format("model {}, seed {}, {} evaluations a level, guidance {}", model, options.seed,
                     result.flows.front().evaluations, options.guidance.guidance_scale);
}

// One progress line a flow-matching stage.
class FlowProgress {
 public:
  void update(const std::string& stage, const SolveProgress& solve) {
    if (stage != stage_) {
      stage_ = stage;
      line_ = std::make_unique<Progress>(stage, solve.steps);
    }
    line_->update(solve.step, fmt::format("t {:.4f}", solve.time));
    if (solve.step == solve.steps) line_->finish();
  }

 private:
  std::string stage_;
  std::unique_ptr<Progress> line_;
};

void print_warnings(const std::vector<std::string>& warnings) {
  for (const auto& warning : warnings) std::cerr << "warning: " << warning << "\n";
}

// What sampling needs before anything is computed.
struct PreparedSampling {
  torch::Device device = torch::kCPU;
  ModelBundle bundle;
  Scene found;
  SamplingScene scene;
};

PreparedSampling prepare(const SampleOptions& options) {
  const torch::Device device = device_from_text(options.device);
  const ModelBundle bundle = ModelBundle::open(options.model);
  const Scene found = open_scene(options.scene, options.reading);
  const TrainedSize size =
      choose_size(options.size, found, trained_sizes(bundle.options()), bundle.options().backbone.patch_size);
  return {device, bundle, found, load_sampling_scene(found, options.views, size)};
}

SamplingPlan plan_of(const PreparedSampling& prepared, const SampleOptions& options) {
  const BundleOptions& bundle = prepared.bundle.options();
  PlanRequest request;
  request.grid = bundle.backbone.grid_of(prepared.scene.views.size(), prepared.scene.size.height,
                                         prepared.scene.size.width);
  request.num_sources = prepared.scene.views.num_sources;
  request.outputs = options.requested();
  request.level1_solver = options.resolved_solver(bundle.level1_time_shift.evaluation);
  request.cascade_solver = options.resolved_solver(bundle.cascade_time_shift.evaluation);
  request.guidance = options.guidance;
  SamplingPlan plan = plan_sampling(bundle, request);
  predict_seconds(plan, measure_machine_speed());
  return plan;
}

std::string scene_line(const SamplingScene& scene) {
  return fmt::format("scene {}: {} source and {} target views at {}x{}\n", scene.name,
                     scene.views.num_sources, scene.views.num_targets(), scene.size.width, scene.size.height);
}

void use_threads(const SampleOptions& options) {
  set_thread_count(options.threads > 0 ? static_cast<int>(options.threads)
                                       : static_cast<int>(std::max(1U, std::thread::hardware_concurrency())));
}

}  // namespace

std::string sampling_plan_report(const SampleOptions& options) {
  use_threads(options);
  const PreparedSampling prepared = prepare(options);
  std::string text = scene_line(prepared.scene) + plan_text(plan_of(prepared, options));
  for (const auto& warning : prepared.scene.warnings) text += "warning: " + warning + "\n";
  return text;
}

void sample(const SampleOptions& options) {
  install_interrupt_handler();
  use_threads(options);
  const PreparedSampling prepared = prepare(options);
  const ModelBundle& bundle = prepared.bundle;
  const SamplingScene& scene = prepared.scene;
  RunFolder run(options.out, "sample", options);
  const RequestedOutputs requested = options.requested();
  PipelineRequest request = make_request(options, bundle.options(), scene, prepared.device);

  const SamplingPlan plan = plan_of(prepared, options);
  std::cout << scene_line(scene) << plan_text(plan) << std::flush;
  print_warnings(scene.warnings);

  StageRecords stages;
  Provenance provenance = make_provenance("sample", options, {"out", "threads"});
  stages.run("hashing the model", [&] { provenance.model_hash = bundle.content_hash(); });
  provenance.seed = options.seed;
  SamplingOutputs outputs(run, scene, requested, provenance);
  FlowProgress progress;
  request.on_step = [&](const std::string& stage, const SolveProgress& solve) {
    progress.update(stage, solve);
  };
  request.on_images = [&](const torch::Tensor& images) { outputs.write_images(images); };
  const PipelineResult result = run_pipeline(bundle_models(bundle, prepared.device), request, stages);
  stages.run("writing",
             [&] { outputs.write_rest(result, one_line_summary(options, result, bundle.options().name)); });

  std::vector<std::string> warnings = scene.warnings;
  // Both flows see the same cameras and warn alike.
  for (const auto& list : {result.warnings, outputs.warnings()}) {
    for (const auto& warning : list) {
      if (std::find(warnings.begin(), warnings.end(), warning) == warnings.end()) warnings.push_back(warning);
    }
  }
  print_warnings({warnings.begin() + static_cast<std::ptrdiff_t>(scene.warnings.size()), warnings.end()});
  nlohmann::ordered_json report;
  report["command"] = "sample";
  report["options"] = to_json(options);
  report["model"] = {
      {"folder", options.model}, {"name", bundle.options().name}, {"hash", provenance.model_hash}};
  report["seed"] = options.seed;
  report["scene"] = {{"name", scene.name},        {"format", prepared.found.format},
                     {"width", scene.size.width}, {"height", scene.size.height},
                     {"views", scene.view_names}, {"sources", scene.views.num_sources}};
  report["threads"] = thread_count();
  report["stages"] = stages.to_json();
  report["plan"] = plan_json(plan);
  report["flows"] = flows_json(result.flows);
  for (const auto& [key, value] : outputs.findings().items()) report[key] = value;
  report["warnings"] = warnings;
  run.write_report(report);
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
