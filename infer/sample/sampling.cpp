#include "infer/sample/sampling.h"

#include "datasets/images/image_file.h"
#include "datasets/loading/batching.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/option_differences.h"
#include "gld/base/printable_text.h"
#include "gld/page/run_report.h"
#include "gld/report/progress.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "gld/tensors/torch_version.h"
#include "infer/forecast/method_choice.h"
#include "infer/forecast/plan_report.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/forecast/splat_forecast.h"
#include "infer/page/report_command.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/request/scene_request.h"
#include "infer/sample/background_hash.h"
#include "infer/sample/picture_verdict.h"
#include "infer/sample/planned_sampling.h"
#include "infer/sample/prepared_sampling.h"
#include "infer/sample/sampling_evidence.h"
#include "infer/sample/sampling_outputs.h"
#include "infer/sample/unfinished_latents.h"
#include "models/bundle/part_lineage.h"
#include "models/bundle/seen_scenes.h"

#include <algorithm>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

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
  if (result.flows.empty()) return fmt::format("model {}, nothing generated", model);
  int64_t evaluations = 0;  // of a flow that was run now
  for (const auto& flow : result.flows) evaluations = std::max(evaluations, flow.evaluations);
  // Where none was, all levels were made before --resume.
  const std::string solved =
      evaluations > 0 ? fmt::format("{} evaluations a level", evaluations) : "levels of an interrupted run";
  return fmt::format("model {}, seed {}, {}, guidance {}{}", model, options.seed, solved,
                     options.guidance.guidance_scale, result.refined > 0 ? ", refined" : "");
}

// It shows the target views side by side as the flow would end now, as long as there are no others.
constexpr const char* kPreviewFile = "preview.png";

// This prints one progress line a flow-matching stage.
class FlowProgress {
 public:
  explicit FlowProgress(std::filesystem::path run) : run_(std::move(run)) {}

  void update(const std::string& stage, const SolveProgress& solve) {
    if (stage != stage_) {
      stage_ = stage;
      line_ = std::make_unique<Progress>(ProgressOf{stage, solve.steps, 0, run_});
    }
    line_->update(solve.step, fmt::format("t {:.4f}", solve.time));
    if (solve.steps > 0 && solve.step == solve.steps) line_->finish();
  }

 private:
  std::filesystem::path run_;
  std::string stage_;
  std::unique_ptr<Progress> line_;
};

// Returns what was not computed because target views were left out of the flows: the plan's operations less those of a
// plan for the others, or of flows and decoding where all were.
double saved_flop(const PreparedSampling& prepared, const SampleOptions& options,
                  const PlannedSampling& planned, const PipelineResult& result) {
  const auto left_out = static_cast<int64_t>(result.carried_only.size());
  if (left_out == 0) return 0;
  const bool all = left_out == prepared.scene.views.num_targets();
  PlanRequest request = plan_request(prepared, options);
  request.flow = planned.settings;
  if (!all) request.grid.views -= left_out;
  const SamplingPlan rest = plan_sampling(prepared.bundle.options(), request);
  const auto flop = [](const SamplingPlan& plan, bool generated) {
    double sum = 0;
    for (const PlannedStage& stage : plan.stages) {
      const bool generates = stage.kind == StageKind::kFlow || stage.kind == StageKind::kSampleRefinement ||
                             stage.kind == StageKind::kPropagation || stage.kind == StageKind::kRgbDecoding;
      if (generates == generated) sum += stage.cost.flop();
    }
    return sum;
  };
  return flop(planned.plan, true) - (all ? 0 : flop(rest, true));
}

std::string planned_text(const PlannedSampling& planned) {
  return choice_text(planned.choice) + plan_text(planned.plan) + planned.speed.origin + "\n";
}

// Returns what was made of the photographs beside showing them to the model: how far they agree on the depth of the
// source views, and how much of each target view comes from them.
nlohmann::ordered_json photographs_json(const SamplingScene& scene, const PipelineResult& result,
                                        const std::vector<ExpectedView>& expected) {
  nlohmann::ordered_json json;
  if (result.stereo) {
    auto confident = nlohmann::ordered_json::array();
    for (const StereoDepth& view : result.stereo->views) confident.push_back(view.confident_share());
    json["confident_depth"] = confident;
    if (const auto& prior = result.stereo->prior; prior && prior->pixels > 0) {
      json["prior"] = {{"pixels", prior->pixels}, {"scale", prior->scale}, {"spread", prior->spread}};
    }
  }
  if (result.composed) {
    auto kept = nlohmann::ordered_json::array();
    for (int64_t target = 0; target < scene.views.num_targets(); ++target) {
      kept.push_back({{"view", scene.view_names[static_cast<size_t>(scene.views.num_sources + target)]},
                      {"share", result.composed->shown[target].mean().item<double>()}});
      if (!expected.empty()) kept.back()["expected_psnr"] = expected[static_cast<size_t>(target)].psnr;
    }
    json["kept"] = kept;
    auto carried = nlohmann::ordered_json::array();
    for (const int64_t target : result.carried_only) {
      carried.push_back(scene.view_names[static_cast<size_t>(scene.views.num_sources + target)]);
    }
    json["carried_only"] = carried;
  }
  return json;
}

// Returns the names of target views, generated or not.
std::string carried_names(const SamplingScene& scene, const PipelineResult& result, bool carried) {
  std::string names;
  for (int64_t target = 0; target < scene.views.num_targets(); ++target) {
    const auto& only = result.carried_only;
    if (carried != (std::find(only.begin(), only.end(), target) != only.end())) continue;
    const auto& name = scene.view_names[static_cast<size_t>(scene.views.num_sources + target)];
    names += (names.empty() ? "" : ", ") + printable_text(name);
  }
  return names.empty() ? "none" : names;
}

std::string photographs_text(const SamplingScene& scene, const PipelineResult& result, double saved_flop,
                             double planned_flop) {
  if (!result.composed) return "";
  const bool nothing_generated =
      static_cast<int64_t>(result.carried_only.size()) == scene.views.num_targets();
  std::string text =
      nothing_generated
          ? "the target views come from the photographs alone\n"
          : fmt::format("{:.0f} % of the target views come from the photographs, the rest is generated\n",
                        100 * result.composed->shown.mean().item<double>());
  if (!result.carried_only.empty()) {
    text += fmt::format(
        "carried, nothing generated: {}; generated: {}; that saved {:.0f} % of {:.3g} TFLOP (--generate-complete)\n",
        carried_names(scene, result, true), carried_names(scene, result, false),
        100 * saved_flop / planned_flop, planned_flop / 1e12);
  }
  return text;
}

// Returns the words in lines of at most so many characters.
std::vector<std::string> lines_of(const std::string& sentence, size_t most) {
  std::vector<std::string> lines(1);
  size_t begin = 0;
  while (begin < sentence.size()) {
    const size_t end = std::min(sentence.find(' ', begin), sentence.size());
    const std::string word = sentence.substr(begin, end - begin);
    if (!lines.back().empty() && lines.back().size() + 1 + word.size() > most) lines.emplace_back();
    lines.back() += (lines.back().empty() ? "" : " ") + word;
    begin = end + 1;
  }
  return lines;
}

SheetText sheet_text(const std::optional<PictureVerdict>& verdict, const std::vector<std::string>& doubts,
                     const std::string& summary) {
  constexpr size_t kLineOfSheet = 110;
  SheetText text;
  text.subtitle = summary;
  if (verdict) text.verdict = lines_of(verdict->sentence, kLineOfSheet);
  for (const std::string& doubt : doubts) {
    for (std::string& line : lines_of("In doubt: " + printable_text(doubt), kLineOfSheet)) {
      text.verdict.push_back(std::move(line));
    }
  }
  return text;
}

// What a sampling was and came to.
struct FinishedSampling {
  const PreparedSampling& prepared;
  const PlannedSampling& planned;
  const PipelineResult& result;
  const StageRecords& stages;
  std::string model_hash;
  std::optional<PictureVerdict> verdict;  // of pictures: none where none were asked for
  PictureEvidence evidence;
};

nlohmann::ordered_json sampling_report(const SampleOptions& options, const FinishedSampling& finished,
                                       const nlohmann::ordered_json& findings,
                                       const std::vector<std::string>& warnings) {
  const PreparedSampling& prepared = finished.prepared;
  const PlannedSampling& planned = finished.planned;
  const SamplingScene& scene = prepared.scene;
  nlohmann::ordered_json report;
  report["command"] = "sample";
  if (finished.verdict) report["verdict"] = verdict_json(*finished.verdict, finished.evidence);
  report["options"] = to_json(options);
  report["model"] = {
      {"folder", options.model}, {"name", prepared.bundle.options().name}, {"hash", finished.model_hash}};
  if (prepared.geometry_model && options.requested().needs_geometry()) {
    report["geometry"] = {{"from", "the generated images"},
                          {"folder", options.geometry_model},
                          {"name", prepared.geometry_model->options().name},
                          {"hash", prepared.geometry_model->content_hash()}};
    if (options.geometry_cameras == GeometryCameras::kGiven) report["geometry"]["cameras"] = "given";
  }
  report["command_line"] = command_line_text("sample", options, SampleOptions()) + " --out runs/again";
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
  if (options.refine) report["refined_views"] = finished.result.refined;
  if (auto photographs = photographs_json(scene, finished.result, expected_views(finished.evidence));
      !photographs.empty()) {
    report["photographs"] = std::move(photographs);
  }
  if (const auto& left_out = finished.evidence.left_out; !left_out.empty()) {
    report["leave_one_out"] = left_out_json(left_out, scene.view_names);
  }
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
  warnings.insert(warnings.end(), prepared.unlike_training.begin(), prepared.unlike_training.end());
  if (!problem.empty()) warnings.push_back(problem);
  // A plan may be made before the weights are there, or while a part is another one's.
  try {
    mixed_parts(prepared.bundle, require_parts(prepared, options), options.allow_mixed);
  } catch (const Error& error) {
    warnings.push_back(std::string("gld sample would not begin: ") + error.what());
  }
  warnings.insert(warnings.end(), planned.speed.doubts.begin(), planned.speed.doubts.end());
  if (options.json) {
    const nlohmann::ordered_json report{{"scene", prepared.scene.name},
                                        {"sampling", choice_json(planned.choice)},
                                        {"plan", plan_json(planned.plan)},
                                        {"predicted_seconds", predicted_seconds_json(planned.plan)},
                                        {"predicted_peak_bytes", planned.plan.peak_bytes()},
                                        {"rates", planned.speed.origin},
                                        {"warnings", warnings}};
    return {json_text(report, 2) + "\n", warnings};
  }
  return {scene_line(prepared.scene) + planned_text(planned), warnings};
}

void sample(const SampleOptions& options) {
  use_threads(options.threads);
  const EarlierRun earlier = options.resume ? EarlierRun::kContinue : earlier_run(options.overwrite);
  check_run_folder(options.out, "sample", earlier);
  if (options.resume) refuse_other_options(options.out, options, SampleOptions(), {"memory_limit"});
  PreparedSampling prepared = prepare(options);
  const ModelBundle& bundle = prepared.bundle;
  SamplingScene& scene = prepared.scene;
  const std::vector<BundlePart> parts = require_parts(prepared, options);
  if (const std::string problem = memory_problem(prepared, options); !problem.empty()) {
    fail({"gld sample", "", "", problem});
  }
  StageRecords stages;
  record_device(stages, prepared.device);
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
  // It does not begin before the plan, which may estimate how fast this machine computes.
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
  PipelineRequest request = pipeline_request(prepared, options, planned.settings);
  // Otherwise it may turn out that nothing is generated.
  if (!request.photographs.leaves_out_complete) {
    print_warnings(prepared.unlike_training);
    add_new(scene.warnings, prepared.unlike_training);
  }
  provenance.seed = options.seed;
  provenance.precision = precision_text(planned.choice.method.precision, planned.choice.device);
  const UnfinishedLatents kept(run.path());
  // A method that is chosen by the machine's speed may be another one next time.
  const std::string method = json_text(to_json(planned.choice.method));
  const std::string inputs = inputs_hash(scene);
  if (options.resume) request.kept_latents = kept.read({wait_for_hash(), method, inputs});
  request.on_latent = [&](int64_t level, const torch::Tensor& latent) {
    kept.write(level, latent, {hash->get(), method, inputs});  // inside a stage, which records no other one
  };
  SamplingOutputs outputs(run, scene, requested, options, provenance);
  FlowProgress progress(run.path());
  stages.on_start([&](const std::string& stage) { note_stage(run.path(), stage); });
  request.on_step = [&](const std::string& stage, const SolveProgress& solve) {
    progress.update(stage, solve);
  };
  const auto preview = run.path() / kPreviewFile;
  request.preview_every = options.preview;
  request.on_preview = [&](const std::string&, const torch::Tensor& images) {
    write_png(preview, to_image(torch::cat(images.unbind(), 2)));
  };
  // Every file names the model's hash.
  request.on_images = [&](const torch::Tensor& images, const std::optional<ComposedViews>& composed) {
    wait_for_hash();
    outputs.write_images(images, composed);
    std::error_code gone;
    std::filesystem::remove(preview, gone);  // the pictures themselves are there
  };
  PipelineModels models = bundle_models(bundle, prepared.device, planned.choice.method.precision);
  if (prepared.geometry_model) take_geometry_from(models, *prepared.geometry_model, prepared.device);
  const PipelineResult result = run_pipeline(models, request, stages);
  wait_for_hash();
  PictureEvidence evidence = sampling_evidence(prepared, result);
  const bool has_pictures = request.image_views != DecodedViews::kNone;
  if (has_pictures && scene.views.num_sources > 1) {
    stages.run("leave one out",
               [&] { evidence.left_out = left_out_photographs(scene, request.photographs, result); });
  }
  std::optional<PictureVerdict> verdict;
  if (has_pictures) verdict = verdict_of(evidence);
  std::vector<std::string> warnings = scene.warnings;
  warnings.insert(warnings.end(), planned.choice.notes.begin(), planned.choice.notes.end());
  const auto printed = static_cast<std::ptrdiff_t>(warnings.size());
  stages.run("writing", [&] {
    if (prepared.photos) write_photo_scene(run, *prepared.photos, provenance);
    outputs.write_rest(result);
  });
  if (requested.splats) stages.run(kSplatStage, [&] { outputs.write_splats(); });
  add_new(warnings, doubts_of_generated(prepared, result));
  add_new(warnings, result.warnings);
  add_new(warnings, outputs.warnings());
  const std::vector<std::string> doubts = doubts_of(verdict, evidence, warnings);
  stages.run("contact sheet", [&] {
    outputs.write_contact_sheet(
        sheet_text(verdict, doubts, one_line_summary(options, result, bundle.options().name)),
        expected_views(evidence));
  });
  print_warnings({warnings.begin() + printed, warnings.end()});
  const auto report =
      sampling_report(options, {prepared, planned, result, stages, provenance.model_hash, verdict, evidence},
                      outputs.findings(), warnings);
  run.write_report(report);
  if (requested.page) {
    write_run_page(run.path(), options.page);
    run.note("page", kPageFile);
  }
  kept.remove();
  // The plan is of all views.
  const bool all_computed =
      result.carried_only.empty() && std::none_of(result.flows.begin(), result.flows.end(),
                                                  [](const FlowReport& flow) { return flow.kept; });
  if (planned.speed.kept && all_computed && options.preview == 0 && prepared.device.is_cpu()) {
    try {
      learn_from_run(machine_rates_file(), present_rate_key(), timed_stages(planned.plan, stages.records()));
    } catch (const Error& error) {  // a cache that cannot be written costs no run
      print_warnings({error.what()});
    }
  }
  run.note("report", "report.json");
  if (options.json) {
    std::cout << json_text(report, 2) << "\n";
  } else {
    std::cout << (verdict ? verdict->sentence + "\n" : "") << left_out_text(evidence.left_out)
              << actual_text(planned.plan, stages.records()) << outputs.scale_text()
              << photographs_text(scene, result, saved_flop(prepared, options, planned, result),
                                  planned.plan.flop())
              << run.closing_box();
    for (const std::string& doubt : doubts) std::cout << "in doubt: " << printable_text(doubt) << "\n";
  }
}

}  // namespace gld
