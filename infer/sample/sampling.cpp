#include "infer/sample/sampling.h"

#include "datasets/formats/scene_reader.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/option_differences.h"
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
#include "infer/sample/photo_scene.h"
#include "infer/sample/sampling_outputs.h"
#include "infer/sample/unfinished_latents.h"
#include "models/bundle/part_lineage.h"
#include "models/bundle/trained_views.h"

#include <algorithm>
#include <iostream>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

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

void print_warnings(const std::vector<std::string>& warnings) {
  for (const auto& warning : warnings) std::cerr << "warning: " << warning << "\n";
}

// Where more or other views are asked for than the model was trained on, a sentence each.
std::vector<std::string> unlike_training(const SamplingScene& scene, const ModelBundle& model) {
  const BundleOptions& bundle = model.options();
  const int64_t views = trained_views(model);
  std::vector<std::string> notes;
  const auto sizes = bundle.image_sizes();
  const bool trained = std::any_of(sizes.begin(), sizes.end(), [&](const ImageSize& size) {
    return size.width == scene.size.width && size.height == scene.size.height;
  });
  if (!trained) {
    notes.push_back(fmt::format("The model was trained on images of {}, these are {}x{}.",
                                fmt::join(bundle.trained_sizes, ", "), scene.size.width, scene.size.height));
  }
  if (views > 0 && scene.views.size() > views) {
    notes.push_back(fmt::format("The model was trained on scenes of {} views, this one has {}.", views,
                                scene.views.size()));
  }
  return notes;
}

// What sampling needs before anything is computed.
struct PreparedSampling {
  torch::Device device = torch::kCPU;
  ModelBundle bundle;
  std::optional<PhotoScene> photos;  // where the cameras were estimated
  Scene found;
  ViewSelection selection;  // as asked for, completed where cameras were estimated
  SamplingScene scene;      // without its images
  std::optional<ModelBundle> geometry_model;
};

void check_lifting(const SampleOptions& options, const ModelBundle& geometry_model) {
  const auto& head = geometry_model.options().dpt_head;
  if (!options.requested().points || options.points.lifting != PointLifting::kPointMaps || !head.exists() ||
      head.architecture().predicts_points()) {
    return;
  }
  fail({"--points.lifting", "cameras or rays of a model whose head predicts no points",
        "point_maps of " + geometry_model.options().name,
        "choose another, or --geometry-model DIR with a head that does (VGGT's)"});
}

// Where depth, rays and points come from.
std::optional<ModelBundle> geometry_model_of(const SampleOptions& options, const ModelBundle& bundle) {
  if (!options.geometry_model.empty()) {
    auto geometry_model = ModelBundle::open(options.geometry_model);
    require_geometry_head(geometry_model);
    check_lifting(options, geometry_model);
    return geometry_model;
  }
  check_lifting(options, bundle);
  if (options.requested().needs_geometry() && !bundle.options().dpt_head.exists()) {
    fail(
        {"--outputs", "image or latents of a model without a geometry head",
         "depth, rays or points of " + options.model,
         "add --outputs image, or --geometry-model DIR to have a geometry model look at the generated images"});
  }
  return std::nullopt;
}

void bundle_has_all(const ModelBundle& bundle, const std::vector<BundlePart>& parts) {
  for (const auto& part : parts) {
    if (bundle.has(part)) continue;
    fail({bundle.folder().string(), "a file " + bundle.file(part).filename().string(), "none",
          "add the part with gld convert or gld train"});
  }
}

PipelineModels geometry_models(const ModelBundle& bundle, const torch::Device& device) {
  if (!bundle.options().dpt_head.exists()) {
    fail({"--photos", "a model with a geometry head, which sees the cameras", bundle.folder().string(),
          "add --geometry-model DIR with one that has, or let COLMAP find the cameras"});
  }
  bundle_has_all(bundle, {BundlePart::backbone(), BundlePart::dpt_head()});
  return bundle_models(bundle, device);
}

// View pairs are decided with the depth of the sources, which the model's own head sees in its own levels.
void check_view_pairs(const SampleOptions& options, const ModelBundle& bundle, int64_t sources) {
  const bool visible = options.method(bundle.options()).approximate.view_pairs == ViewPairs::kVisible;
  if (!visible || sources < 2 || bundle.options().dpt_head.exists()) return;
  fail({"--approximate.view-pairs", "all for a model without a geometry head", "visible", "leave it out"});
}

// Reads no pixels of a scene that has cameras: what is wrong with the options, the model or the cameras, or does not fit,
// is said first.
PreparedSampling prepare(const SampleOptions& options) {
  const torch::Device device = device_from_text(options.device);
  const ModelBundle bundle = ModelBundle::open(options.model);
  auto geometry_model = geometry_model_of(options, bundle);
  std::optional<PhotoScene> photos;
  if (!options.photos.files.empty()) {
    // A geometry model that is named for the generated images sees the cameras as well.
    photos = photo_scene(options.photos, options.size, bundle.options(),
                         geometry_models(geometry_model ? *geometry_model : bundle, device), device);
  }
  const Scene found = photos ? photos->scene : open_scene(options.scene, options.reading);
  const ImageSize size = choose_size(options.size, found, bundle.options().image_sizes(),
                                     bundle.options().backbone.patch_side());
  ViewSelection selection = options.views;
  // Of photographs all are sources, and the targets lie between them, unless the options say otherwise.
  if (photos && selection.sources.empty()) {
    for (size_t i = 0; i < found.frames.size(); ++i) selection.sources.push_back(static_cast<int64_t>(i));
  }
  if (photos && selection.targets.empty() && selection.path.path.empty()) {
    selection.path.path = found.frames.size() > 1 ? "spline" : "orbit";
  }
  SamplingScene views = sampling_views(found, selection, size);
  check_view_pairs(options, bundle, views.views.num_sources);
  PreparedSampling prepared{device,
                            bundle,
                            std::move(photos),
                            found,
                            std::move(selection),
                            std::move(views),
                            std::move(geometry_model)};
  const auto notes = unlike_training(prepared.scene, bundle);
  prepared.scene.warnings.insert(prepared.scene.warnings.end(), notes.begin(), notes.end());
  return prepared;
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

PlanRequest plan_request(const PreparedSampling& prepared, const SampleOptions& options) {
  PlanRequest request;
  const ImageSize& size = prepared.scene.size;
  request.grid =
      prepared.bundle.options().backbone.grid_of(prepared.scene.views.size(), size.height, size.width);
  request.num_sources = prepared.scene.views.num_sources;
  request.outputs = options.requested();
  if (prepared.geometry_model) {
    request.geometry_model = std::make_shared<const BundleOptions>(prepared.geometry_model->options());
  }
  return request;
}

StageRequest stage_request(const PreparedSampling& prepared, const SampleOptions& options) {
  PlanRequest request = plan_request(prepared, options);
  request.flow.approximate = options.method(prepared.bundle.options()).approximate;
  return request.stage_request();
}

// The pixels of the views that were chosen without them.
void load_pixels(PreparedSampling& prepared, const SampleOptions& options) {
  SamplingScene loaded = load_sampling_scene(prepared.found, prepared.selection, prepared.scene.size);
  const auto& kinds = options.scale_from;
  if (std::find(kinds.begin(), kinds.end(), "source_depth") != kinds.end()) {
    load_source_depths(prepared.found, prepared.selection, loaded);
    const auto& depths = loaded.source_depths;
    if (std::all_of(depths.begin(), depths.end(), [](const DepthMap& depth) { return depth.empty(); })) {
      fail({"--scale-from source_depth", "a source view with measured depth", "none",
            "leave it out, or choose sources that have depth"});
    }
  }
  loaded.warnings = std::move(prepared.scene.warnings);  // which are more
  prepared.scene = std::move(loaded);
}

// Why the scene does not fit into memory and what would; empty where it fits. Of a GPU's own memory nothing is known here.
std::string memory_problem(const PreparedSampling& prepared, const SampleOptions& options) {
  if (!prepared.device.is_cpu()) return "";
  PlanRequest request = plan_request(prepared, options);
  request.flow =
      flow_settings(options.method(prepared.bundle.options()), options.guidance, prepared.bundle.options());
  constexpr double kGigabyte = 1e9;
  const auto limit = options.memory_limit > 0 ? static_cast<int64_t>(options.memory_limit * kGigabyte)
                                              : available_memory_bytes();
  if (limit <= 0) return "";  // the system does not tell
  return memory_refusal(prepared.bundle.options(), request, limit);
}

void refuse_too_large(const PreparedSampling& prepared, const SampleOptions& options) {
  const std::string problem = memory_problem(prepared, options);
  if (!problem.empty()) fail({"gld sample", "", "", problem});
}

PlannedSampling plan_of(const PreparedSampling& prepared, const SampleOptions& options, PlanTiming timing,
                        const std::function<std::string()>& model_hash) {
  const BundleOptions& bundle = prepared.bundle.options();
  const Views& views = prepared.scene.views;
  PlanRequest request = plan_request(prepared, options);
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
  return fmt::format("scene {}: {} source and {} target views at {}x{}\n{}", scene.name,
                     scene.views.num_sources, scene.views.num_targets(), scene.size.width, scene.size.height,
                     scene.path_note.empty() ? "" : scene.path_note + "\n");
}

}  // namespace

std::string sampling_plan_report(const SampleOptions& options, PlanTiming timing) {
  use_threads(options.threads);
  const PreparedSampling prepared = prepare(options);
  const std::string problem = memory_problem(prepared, options);
  const auto planned = plan_of(prepared, options, timing, [&] { return prepared.bundle.content_hash(); });
  std::vector<std::string> warnings = planned.choice.notes;
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
    return json_text(report, 2) + "\n";
  }
  std::string text = scene_line(prepared.scene) + planned_text(planned);
  for (const auto& warning : warnings) text += "warning: " + warning + "\n";
  return text;
}

void sample(const SampleOptions& options) {
  use_threads(options.threads);
  const EarlierRun earlier = options.resume ? EarlierRun::kContinue : earlier_run(options.overwrite);
  check_run_folder(options.out, "sample", earlier);
  if (options.resume) refuse_other_options(options.out, options, {"memory_limit"});
  PreparedSampling prepared = prepare(options);
  const ModelBundle& bundle = prepared.bundle;
  SamplingScene& scene = prepared.scene;
  const StageRequest stage_wishes = stage_request(prepared, options);
  auto parts = needed_parts(bundle.options(), stage_wishes);
  if (prepared.geometry_model) {
    // Its backbone and head look at the generated images; this bundle's head is asked for view pairs alone.
    const auto head = std::find(parts.begin(), parts.end(), BundlePart::dpt_head());
    if (head != parts.end() && !stage_wishes.source_depth()) parts.erase(head);
    bundle_has_all(*prepared.geometry_model, {BundlePart::backbone(), BundlePart::dpt_head()});
  }
  bundle_has_all(bundle, parts);
  refuse_too_large(prepared, options);
  for (auto& note : mixed_parts(bundle, parts, options.allow_mixed))
    scene.warnings.push_back(std::move(note));

  StageRecords stages;
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
  provenance.precision = precision_text(planned.choice.method.precision);
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
  if (prepared.geometry_model && requested.needs_geometry()) {
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
  report["precision"] = precision_text(planned.choice.method.precision);
  report["stages"] = stages.to_json();
  report["sampling"] = choice_json(planned.choice);
  report["plan"] = plan_json(planned.plan, stages.records());
  report["flows"] = flows_json(result.flows);
  if (result.view_pairs) report["view_pairs"] = view_pairs_json(*result.view_pairs);
  for (const auto& [key, value] : outputs.findings().items()) report[key] = value;
  report["warnings"] = warnings;
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
