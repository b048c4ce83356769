#include "infer/sample/sampling.h"

#include "datasets/formats/scene_reader.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/cameras/view_visibility.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "gld/tensors/torch_version.h"
#include "infer/forecast/method_choice.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/pipeline/scene_request.h"
#include "infer/pipeline/visible_pairs.h"
#include "infer/sample/background_hash.h"
#include "infer/sample/sampling_outputs.h"

#include <algorithm>
#include <iostream>
#include <memory>

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

using SceneLoader = SamplingScene (*)(const Scene&, const ViewSelection&, const ImageSize&);

PreparedSampling prepare(const SampleOptions& options, SceneLoader load) {
  const torch::Device device = device_from_text(options.device);
  const ModelBundle bundle = ModelBundle::open(options.model);
  const Scene found = open_scene(options.scene, options.reading);
  const ImageSize size = choose_size(options.size, found, bundle.options().image_sizes(),
                                     bundle.options().backbone.patch_side());
  return {device, bundle, found, load(found, options.views, size)};
}

// The method and what it would take. model_hash is called where the bundle's measured errors are needed.
struct PlannedSampling {
  ChosenMethod choice;
  FlowSettings settings;
  SamplingPlan plan;
  std::string speed_origin;  // of the machine's speed that the plan's times come from
  // By the cameras alone; the pipeline may find fewer pairs with the sources' depth.
  ViewVisibility visibility;
};

PlannedSampling plan_of(const PreparedSampling& prepared, const SampleOptions& options, PlanTiming timing,
                        const std::function<std::string()>& model_hash) {
  const BundleOptions& bundle = prepared.bundle.options();
  const Views& views = prepared.scene.views;
  PlanRequest request;
  request.grid = bundle.backbone.grid_of(views.size(), prepared.scene.size.height, prepared.scene.size.width);
  request.num_sources = views.num_sources;
  request.outputs = options.requested();
  PlannedSampling planned;
  planned.visibility = view_visibility(views);
  request.visible_share = planned.visibility.kept();
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
         (some_pairs ? view_visibility_text(planned.visibility) : "");
}

std::string scene_line(const SamplingScene& scene) {
  return fmt::format("scene {}: {} source and {} target views at {}x{}\n", scene.name,
                     scene.views.num_sources, scene.views.num_targets(), scene.size.width, scene.size.height);
}

}  // namespace

std::string sampling_plan_report(const SampleOptions& options, PlanTiming timing) {
  use_threads(options.threads);
  const PreparedSampling prepared = prepare(options, sampling_views);
  const auto planned = plan_of(prepared, options, timing, [&] { return prepared.bundle.content_hash(); });
  std::string text = scene_line(prepared.scene) + planned_text(planned);
  for (const auto& list : {planned.choice.notes, prepared.scene.warnings}) {
    for (const auto& warning : list) text += "warning: " + warning + "\n";
  }
  return text;
}

void sample(const SampleOptions& options) {
  install_interrupt_handler();
  use_threads(options.threads);
  const PreparedSampling prepared = prepare(options, load_sampling_scene);
  const ModelBundle& bundle = prepared.bundle;
  const SamplingScene& scene = prepared.scene;

  StageRecords stages;
  Provenance provenance = make_provenance("sample", options, {"out", "threads"});
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
  RunFolder run(options.out, "sample", options);
  const RequestedOutputs requested = options.requested();
  PipelineRequest request = make_request(options, planned.settings, bundle.options(), scene, prepared.device);
  std::cout << scene_line(scene) << planned_text(planned) << std::flush;
  print_warnings(planned.choice.notes);
  print_warnings(scene.warnings);
  provenance.seed = options.seed;
  provenance.precision = precision_text(planned.choice.method.precision);
  SamplingOutputs outputs(run, scene, requested, options.points, provenance);
  FlowProgress progress;
  request.on_step = [&](const std::string& stage, const SolveProgress& solve) {
    progress.update(stage, solve);
  };
  // Every file names the model's hash.
  request.on_images = [&](const torch::Tensor& images) {
    wait_for_hash();
    outputs.write_images(images);
  };
  const PipelineResult result =
      run_pipeline(bundle_models(bundle, prepared.device, planned.choice.method.precision), request, stages);
  wait_for_hash();
  stages.run("writing",
             [&] { outputs.write_rest(result, one_line_summary(options, result, bundle.options().name)); });

  std::vector<std::string> warnings = scene.warnings;
  warnings.insert(warnings.end(), planned.choice.notes.begin(), planned.choice.notes.end());
  const size_t printed = warnings.size();
  // Both flows see the same cameras and warn alike.
  for (const auto& list : {result.warnings, outputs.warnings()}) {
    for (const auto& warning : list) {
      if (std::find(warnings.begin(), warnings.end(), warning) == warnings.end()) warnings.push_back(warning);
    }
  }
  print_warnings({warnings.begin() + static_cast<std::ptrdiff_t>(printed), warnings.end()});
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
  report["precision"] = precision_text(planned.choice.method.precision);
  report["stages"] = stages.to_json();
  report["sampling"] = choice_json(planned.choice);
  report["plan"] = plan_json(planned.plan, stages.records());
  report["flows"] = flows_json(result.flows);
  if (result.view_pairs) report["view_pairs"] = view_pairs_json(*result.view_pairs);
  for (const auto& [key, value] : outputs.findings().items()) report[key] = value;
  report["warnings"] = warnings;
  run.write_report(report);
  run.note("report", "report.json");
  std::cout << actual_text(planned.plan, stages.records()) << run.closing_box();
}

}  // namespace gld
