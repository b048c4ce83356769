#include "infer/sample/sampling.h"

#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/option_differences.h"
#include "gld/base/printable_text.h"
#include "gld/cameras/view_visibility.h"
#include "gld/report/progress.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/torch_version.h"
#include "infer/forecast/method_choice.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/pipeline/scene_request.h"
#include "infer/pipeline/visible_pairs.h"
#include "infer/sample/background_hash.h"
#include "infer/sample/prepared_sampling.h"
#include "infer/sample/sampling_outputs.h"
#include "infer/sample/unfinished_latents.h"
#include "models/bundle/part_lineage.h"

#include <algorithm>
#include <iostream>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

PipelineRequest make_request(const SampleOptions& options, const FlowSettings& settings,
                             const BundleOptions& bundle, const SamplingScene& scene,
                             const torch::Device& device) {
  const RequestedOutputs requested = options.requested();
  PipelineRequest request = scene_request(scene, bundle, options.seed, device);
  request.flow = settings;
  request.savings = options.savings();
  request.image_views = requested.image_views();
  request.geometry_views = requested.geometry_views();
  request.geometry_maps = requested.geometry_maps();
  return request;
}

nlohmann::ordered_json flows_json(const std::vector<FlowReport>& flows) {
  auto list = nlohmann::ordered_json::array();
  for (const auto& flow : flows) {
    if (flow.kept) {
      list.push_back({{"stage", flow.stage}, {"kept", "its level was made before --resume"}});
      continue;
    }
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
  int64_t evaluations = 0;  // of a flow that was run now
  for (const auto& flow : result.flows) evaluations = std::max(evaluations, flow.evaluations);
  return fmt::format("model {}, seed {}, {} evaluations a level, guidance {}", model, options.seed,
                     evaluations, options.guidance.guidance_scale);
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

// The method and what it would take. model_hash is called where the bundle's measured errors are needed.
struct PlannedSampling {
  ChosenMethod choice;
  FlowSettings settings;
  SamplingPlan plan;
  std::string speed_origin;  // of the machine's speed that the plan's times come from
  // By the cameras alone, where they are known; the pipeline may find fewer pairs with the sources' depth.
  std::optional<ViewVisibility> visibility;
};

PlannedSampling plan_of(const PreparedSampling& prepared, const SampleOptions& options, PlanTiming timing,
                        const std::function<std::string()>& model_hash) {
  const BundleOptions& bundle = prepared.bundle.options();
  PlanRequest request = plan_request(prepared, options);
  PlannedSampling planned;
  if (prepared.cameras_known()) {
    planned.visibility = view_visibility(prepared.scene.views);
    request.visible_share = planned.visibility->kept();
  }
  const KnownSpeed known = timing == PlanTiming::kMeasured ? renew_machine_speed() : known_machine_speed();
  planned.choice = choose_method(options, prepared.bundle, request, known.speed, model_hash);
  planned.settings = flow_settings(planned.choice.method, options.guidance, bundle);
  request.flow = planned.settings;
  planned.plan = plan_sampling(bundle, request);
  planned.speed_origin = known.origin;
  if (timing == PlanTiming::kMeasured) {
    measure_seconds(planned.plan, bundle, request, known.speed);
  } else {
    predict_seconds(planned.plan, known.speed);
  }
  return planned;
}

std::string planned_text(const PlannedSampling& planned) {
  const bool some_pairs = planned.settings.approximate.view_pairs == ViewPairs::kVisible;
  return choice_text(planned.choice) + plan_text(planned.plan) + planned.speed_origin + "\n" +
         (some_pairs && planned.visibility ? view_visibility_text(*planned.visibility) : "");
}

// What a sampling was and came to.
struct FinishedSampling {
  const PreparedSampling& prepared;
  const PlannedSampling& planned;
  const PipelineResult& result;
  const StageRecords& stages;
  std::string model_hash;
};

nlohmann::ordered_json sampling_report(const SampleOptions& options, const FinishedSampling& finished,
                                       const nlohmann::ordered_json& findings,
                                       const std::vector<std::string>& warnings) {
  const PreparedSampling& prepared = finished.prepared;
  const PlannedSampling& planned = finished.planned;
  const SamplingScene& scene = prepared.scene;
  nlohmann::ordered_json report;
  report["command"] = "sample";
  report["options"] = to_json(options);
  report["model"] = {
      {"folder", options.model}, {"name", prepared.bundle.options().name}, {"hash", finished.model_hash}};
  if (prepared.geometry_model && options.requested().needs_geometry()) {
    report["geometry"] = {{"from", "the generated images"},
                          {"folder", options.geometry_model},
                          {"name", prepared.geometry_model->options().name},
                          {"hash", prepared.geometry_model->content_hash()}};
  }
  report["seed"] = options.seed;
  report["scene"] = {{"name", scene.name},        {"format", prepared.found.format},
                     {"width", scene.size.width}, {"height", scene.size.height},
                     {"views", scene.view_names}, {"sources", scene.views.num_sources}};
  if (prepared.photos) report["photo_cameras"] = photo_scene_json(*prepared.photos);
  report["threads"] = thread_count();
  report["precision"] = precision_text(planned.choice.method.precision, planned.choice.device);
  report["stages"] = finished.stages.to_json();
  report["sampling"] = choice_json(planned.choice);
  report["plan"] = plan_json(planned.plan, finished.stages.records());
  report["flows"] = flows_json(finished.result.flows);
  if (finished.result.view_pairs) report["view_pairs"] = view_pairs_json(*finished.result.view_pairs);
  for (const auto& [key, value] : findings.items()) report[key] = value;
  report["warnings"] = warnings;
  return report;
}

// Both flows see the same cameras and warn alike.
void add_new(std::vector<std::string>& warnings, const std::vector<std::string>& more) {
  for (const auto& warning : more) {
    if (std::find(warnings.begin(), warnings.end(), warning) == warnings.end()) warnings.push_back(warning);
  }
}

std::string scene_line(const SamplingScene& scene) {
  return fmt::format("scene {}: {} source and {} target views at {}x{}\n{}", printable_text(scene.name),
                     scene.views.num_sources, scene.views.num_targets(), scene.size.width, scene.size.height,
                     scene.path_note.empty() ? "" : scene.path_note + "\n");
}

}  // namespace

ReportText sampling_plan_report(const SampleOptions& options, PlanTiming timing) {
  use_threads(options.threads);
  const PreparedSampling prepared = prepare(options);
  const std::string problem = memory_problem(prepared, options);
  const auto planned = plan_of(prepared, options, timing, [&] { return prepared.bundle.content_hash(); });
  std::vector<std::string> warnings = thread_warnings(options.threads);
  warnings.insert(warnings.end(), planned.choice.notes.begin(), planned.choice.notes.end());
  warnings.insert(warnings.end(), prepared.scene.warnings.begin(), prepared.scene.warnings.end());
  if (!problem.empty()) warnings.push_back(problem);
  if (options.json) {
    const nlohmann::ordered_json report{{"scene", prepared.scene.name},
                                        {"sampling", choice_json(planned.choice)},
                                        {"plan", plan_json(planned.plan)},
                                        {"predicted_seconds", planned.plan.seconds()},
                                        {"predicted_peak_bytes", planned.plan.peak_bytes()},
                                        {"rates", planned.speed_origin},
                                        {"warnings", warnings}};
    return {json_text(report, 2) + "\n", warnings};
  }
  return {scene_line(prepared.scene) + planned_text(planned), warnings};
}

void sample(const SampleOptions& options) {
  use_threads(options.threads);
  const EarlierRun earlier = options.resume ? EarlierRun::kContinue : earlier_run(options.overwrite);
  check_run_folder(options.out, "sample", earlier);
  if (options.resume) refuse_other_options(options.out, options, {"memory_limit"});
  PreparedSampling prepared = prepare(options);
  const ModelBundle& bundle = prepared.bundle;
  SamplingScene& scene = prepared.scene;
  const std::vector<BundlePart> parts = require_parts(prepared, options);
  if (const std::string problem = memory_problem(prepared, options); !problem.empty()) {
    fail({"gld sample", "", "", problem});
  }
  StageRecords stages;
  if (!prepared.photographs.empty()) estimate_cameras(prepared, options, stages);
  for (auto& note : mixed_parts(bundle, parts, options.allow_mixed))
    scene.warnings.push_back(std::move(note));

  Provenance provenance = make_provenance("sample", options);
  std::unique_ptr<BackgroundHash> hash;
  const auto wait_for_hash = [&] {
    if (!hash) hash = std::make_unique<BackgroundHash>(bundle);
    if (provenance.model_hash.empty()) {
      stages.run("hashing the model", [&] { provenance.model_hash = hash->get(); });
    }
    return provenance.model_hash;
  };
  const PlannedSampling planned = plan_of(prepared, options, PlanTiming::kPredicted, wait_for_hash);
  // Not before the plan, which may estimate how fast this machine computes.
  if (!hash) hash = std::make_unique<BackgroundHash>(bundle);
  if (!options.json) {
    std::cout << scene_line(scene) << planned_text(planned);
    if (prepared.photos) std::cout << prepared.photos->text;
    std::cout << std::flush;
  }
  print_warnings(thread_warnings(options.threads));
  print_warnings(planned.choice.notes);
  print_warnings(scene.warnings);
  load_pixels(prepared, options);
  if (prepared.geometry_model && options.requested().needs_geometry() && !options.json) {
    std::cout << "depth, rays and points are what " << prepared.geometry_model->options().name
              << " sees in the generated images\n";
  }
  RunFolder run(options.out, "sample", options, earlier);
  const RequestedOutputs requested = options.requested();
  PipelineRequest request = make_request(options, planned.settings, bundle.options(), scene, prepared.device);
  provenance.seed = options.seed;
  provenance.precision = precision_text(planned.choice.method.precision, planned.choice.device);
  const UnfinishedLatents kept(run.path());
  // A method that is chosen by the machine's speed may be another one next time.
  const std::string method = json_text(to_json(planned.choice.method));
  if (options.resume) request.kept_latents = kept.read({wait_for_hash(), method});
  request.on_latent = [&](int64_t level, const torch::Tensor& latent) {
    kept.write(level, latent, {hash->get(), method});  // inside a stage, which records no other one
  };
  SamplingOutputs outputs(run, scene, requested, options, provenance);
  FlowProgress progress;
  request.on_step = [&](const std::string& stage, const SolveProgress& solve) {
    progress.update(stage, solve);
  };
  // Every file names the model's hash.
  request.on_images = [&](const torch::Tensor& images) {
    wait_for_hash();
    outputs.write_images(images);
  };
  PipelineModels models = bundle_models(bundle, prepared.device, planned.choice.method.precision);
  if (prepared.geometry_model) take_geometry_from(models, *prepared.geometry_model, prepared.device);
  const PipelineResult result = run_pipeline(models, request, stages);
  wait_for_hash();
  stages.run("writing", [&] {
    if (prepared.photos) write_photo_scene(run, *prepared.photos, provenance);
    outputs.write_rest(result, one_line_summary(options, result, bundle.options().name));
  });

  std::vector<std::string> warnings = scene.warnings;
  warnings.insert(warnings.end(), planned.choice.notes.begin(), planned.choice.notes.end());
  const auto printed = static_cast<std::ptrdiff_t>(warnings.size());
  add_new(warnings, result.warnings);
  add_new(warnings, outputs.warnings());
  print_warnings({warnings.begin() + printed, warnings.end()});
  const auto report = sampling_report(options, {prepared, planned, result, stages, provenance.model_hash},
                                      outputs.findings(), warnings);
  run.write_report(report);
  kept.remove();
  run.note("report", "report.json");
  if (options.json) {
    std::cout << json_text(report, 2) << "\n";
  } else {
    std::cout << actual_text(planned.plan, stages.records()) << outputs.scale_text() << run.closing_box();
  }
}

}  // namespace gld
