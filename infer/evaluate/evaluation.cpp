#include "infer/evaluate/evaluation.h"

#include "datasets/images/image_file.h"
#include "datasets/images/png_file.h"
#include "datasets/loading/dataset.h"
#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/json_text.h"
#include "gld/base/option_differences.h"
#include "gld/base/sha256.h"
#include "gld/distributed/shared_work.h"
#include "gld/report/distinct_names.h"
#include "gld/report/progress.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "infer/evaluate/attention_correspondence.h"
#include "infer/evaluate/evaluation_report.h"
#include "infer/evaluate/scene_evaluation.h"
#include "infer/evaluate/scene_record.h"
#include "infer/evaluate/scene_sheet.h"
#include "infer/pipeline/bundle_models.h"
#include "models/bundle/part_lineage.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <optional>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

// What a run keeps of a scene that is done.
struct KeptScene {
  std::vector<SceneEvaluation> by_count;  // one a number of sources
  std::vector<AttentionCorrespondence> attention;
  std::vector<std::string> warnings;  // of the scene
};

// What a record is of: another scene of the same number, or a scene as other weights show it, has to be measured.
struct RecordOf {
  std::string models;  // content of all of them
  std::string scene;
};

// A scene that was measured just now, by this process or another.
struct MeasuredScene {
  KeptScene kept;
  std::string sheet;  // its contact sheet as PNG; empty where none was asked for
};

// Returns the checksum over everything but itself.
std::string checksum_of(nlohmann::ordered_json kept) {
  kept.erase("checksum");
  Sha256 hash;
  hash.update(json_text(kept));
  return hash.hex_digest();
}

std::string text_of(const KeptScene& scene, const RecordOf& of) {
  nlohmann::ordered_json kept{{"models", of.models},
                              {"scene", of.scene},
                              {"by_sources", nlohmann::ordered_json::array()},
                              {"attention", attention_record(scene.attention)},
                              {"warnings", scene.warnings}};
  for (const SceneEvaluation& entry : scene.by_count) kept["by_sources"].push_back(scene_record(entry));
  kept["checksum"] = checksum_of(kept);
  return json_text(kept, 1) + "\n";
}

// Returns nothing for text that is no record, a damaged one, or one of something else. Text of JSON is UTF-8: names are
// compared as they are written.
std::optional<KeptScene> scene_of(const std::string& text, const RecordOf& of, const std::string& where) {
  try {
    const auto kept = nlohmann::ordered_json::parse(text);
    if (kept.at("checksum") != checksum_of(kept)) return std::nullopt;
    const nlohmann::ordered_json wanted{{"models", of.models}, {"scene", of.scene}};
    const nlohmann::ordered_json found{{"models", kept.at("models")}, {"scene", kept.at("scene")}};
    if (json_text(found) != json_text(wanted)) return std::nullopt;
    KeptScene scene;
    for (const auto& entry : kept.at("by_sources")) scene.by_count.push_back(scene_from_record(entry, where));
    scene.attention = attention_from_record(kept.at("attention"));
    scene.warnings = kept.at("warnings").get<std::vector<std::string>>();
    return scene;
  } catch (const nlohmann::json::exception&) {
    return std::nullopt;
  } catch (const Error&) {
    return std::nullopt;
  }
}

// The scenes that are done, a file each, and their contact sheets.
class SceneRecords {
 public:
  SceneRecords(std::filesystem::path folder, std::function<RecordOf(int64_t)> of)
      : folder_(std::move(folder)), of_(std::move(of)) {}

  std::filesystem::path sheet(int64_t index) const { return folder_ / fmt::format("{:06}.png", index); }

  // Returns nothing where the scene is still to be measured, which one with a damaged record is.
  std::optional<KeptScene> find(int64_t index) const {
    const auto file = record(index);
    if (!std::filesystem::is_regular_file(file)) return std::nullopt;
    return scene_of(read_file(file), of_(index), file.string());
  }

  // The sheet is written first: a scene that has a record is done.
  void write(int64_t index, const std::string& kept_text, const std::string& png) const {
    if (!png.empty()) write_file_atomically(sheet(index), png);
    write_file_atomically(record(index), kept_text);
  }

 private:
  std::filesystem::path record(int64_t index) const { return folder_ / fmt::format("{:06}.json", index); }

  std::filesystem::path folder_;
  std::function<RecordOf(int64_t)> of_;
};

// Returns the scenes with the largest, the middle and the least PSNR of the sample; fewer than 3 scenes have no such.
std::vector<std::pair<std::string, size_t>> chosen_scenes(const std::vector<SceneEvaluation>& scenes) {
  std::vector<size_t> order;
  for (size_t i = 0; i < scenes.size(); ++i) {
    if (!std::isnan(scenes[i].number("sample_psnr").value)) order.push_back(i);
  }
  if (order.size() < 3) return {};
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return scenes[a].number("sample_psnr").value > scenes[b].number("sample_psnr").value;
  });
  return {{"best", order.front()}, {"median", order[order.size() / 2]}, {"worst", order.back()}};
}

// A record that was taken over from another run may have no sheet.
void copy_sheet(const std::filesystem::path& from, const std::filesystem::path& to) {
  if (std::filesystem::is_regular_file(from)) copy_file_atomically(from, to);
}

nlohmann::ordered_json protocol_json(const EvaluationOptions& options, const BundleOptions& bundle) {
  const auto blind = no_geometry_of_samples(bundle);
  nlohmann::ordered_json protocol{
      {"samples", options.samples},
      {"poses", pose_estimator_names().at(static_cast<size_t>(options.poses))},
      {"poses_from", !options.pose_model.empty() ? options.pose_model
                     : blind                     ? "nothing: " + *blind
                                                 : "the model's own geometry head"},
      {"lpips", options.lpips.lpips_backbone.empty() ? nlohmann::ordered_json()
                                                     : nlohmann::ordered_json(options.lpips.lpips_backbone)},
      {"true_depth", "measured"},
      {"pseudo_depth", bundle.geometry_head.predicts_rays() ? "of the model's own head on the true pictures"
                                                            : std::string("nothing: ") + kNoCameraHead}};
  if (!options.source_counts.empty()) protocol["source_counts"] = options.source_counts;
  return protocol;
}

nlohmann::ordered_json methods_json(const SamplingMethod& sampling, const EvaluationOptions& options) {
  return {{"sample",
           {{"method", method_text(sampling, options.device)},
            {"guidance_scale", options.guidance.guidance_scale}}},
          {"mean_prediction", {{"method", "one evaluation a level"}, {"guidance_scale", 1}}}};
}

}  // namespace

EvaluationOptions::EvaluationOptions() : views(held_out_views()) {}

void EvaluationOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "bundle folder"}, model);
  visitor.boolean({"allow_mixed", "take parts that were not trained on each other"}, allow_mixed);
  visit_out(visitor, out, overwrite);
  visitor.boolean({"resume", "go on with an interrupted run of the same options, with the next scene"},
                  resume);
  visit_json(visitor, json);
  visitor.integer({"synthetic", "number of generated scenes"}, synthetic, {0, 1'000'000});
  visitor.integer(
      {"synthetic_seed",
       "seed of the generated scenes, which training must not have used, and of the views that are drawn of given ones"},
      synthetic_seed, {0, 1'000'000'000'000});
  visit_scenes(visitor, scenes, "generated ones");
  visitor.group({"generator", "generated scenes; seed and number come from the options above"}, generator);
  visitor.group({"views", "which frames are sources and targets"}, views);
  visitor.integers({"source_counts",
                    "numbers of sources to evaluate each scene with, targets the same; "
                    "empty: once, as views says"},
                   source_counts, {1, 1000});
  visitor.integers({"source_frames", "frames that are sources in every scene; empty: views chooses"},
                   source_frames, {0, 1'000'000});
  visitor.integers({"target_frames", "frames that are targets in every scene"}, target_frames,
                   {0, 1'000'000});
  visitor.group({"photograph_use", "what is made of the photographs beside showing them to the model"},
                photograph_use);
  visitor.integer(
      {"samples",
       "samples of each scene; numbers are means over them, energy scores of 2 or more are of all together"},
      samples, {1, 10'000});
  visitor.group({"solver", "solver of both flows, for the samples"}, solver);
  visitor.group({"guidance", "guidance of both flows, for the samples"}, guidance);
  visitor.boolean(
      {"refine", "repair the samples' latents in one call a target view, with the model's refiner"}, refine);
  visit_seed(visitor, seed,
             "the first scene's noise, each next scene has the next one, each next sample the next million");
  visit_choice(
      visitor,
      {"poses",
       "what finds the cameras of samples: our fit to rays, DA3's or GLD's, VGGT's camera head, DA3's decoder"},
      poses, pose_estimator_names());
  visitor.text(
      {"pose_model",
       "bundle whose geometry head looks at the generated pictures for poses; empty: the model's own"},
      pose_model);
  visitor.reals(
      {"attention_times", "flow times at which the DiTs' queries and keys are matched; empty: not at all"},
      attention_times, {0.0, 1.0});
  lpips.visit(visitor);
  visitor.integer({"pictures", "scenes that are drawn as contact sheets"}, pictures, {0, 1'000'000});
  visit_choice(visitor, {"precision", "what models multiply in; on a GPU float32 or bfloat16"}, precision,
               compute_precision_names());
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visitor.group(
      {"processes", "several processes that share the scenes; torchrun sets the environment that is meant"},
      processes);
}

void EvaluationOptions::check() const {
  if (scenes.empty() && synthetic == 0) {
    fail({"gld eval", "scenes", "none", "give --scenes DIR or --synthetic N"});
  }
  check_evaluated_views(evaluated_views());
  if (resume && overwrite) {
    fail({"--resume, --overwrite", "one of the two", "both",
          "--resume goes on with the run, --overwrite removes it"});
  }
  lpips.check();
  check_precision_on(device, precision);
  check_out(out, "runs/eval");
}

SamplingMethod EvaluationOptions::sampling_method() const {
  SamplingMethod method = method_of_options(solver, guidance, ApproximateSavings(), precision);
  method.refine = refine;
  return method;
}

EvaluatedViews EvaluationOptions::evaluated_views() const {
  return {views, source_frames, target_frames, source_counts};
}

namespace {

// Returns the seeds of a scene's samples: the first is what one sample alone would have.
std::vector<int64_t> noise_seeds(const EvaluationOptions& options, int64_t scene) {
  constexpr int64_t kNextSample = 1'000'000;
  std::vector<int64_t> seeds;
  for (int64_t sample = 0; sample < options.samples; ++sample) {
    seeds.push_back(options.seed + scene + sample * kNextSample);
  }
  return seeds;
}

EvaluationModels load_models(const EvaluationOptions& options, const ModelBundle& bundle,
                             const torch::Device& device) {
  EvaluationModels models;
  models.bundle = bundle.options();
  models.models = kept_bundle_models(bundle, device, options.precision);
  models.lpips = load_lpips(options.lpips);
  models.device = device;
  models.photographs = photograph_use_of(options.photograph_use, bundle);
  models.poses = options.poses;
  GeometryHeadOptions seeing = models.bundle.geometry_head;
  if (!options.pose_model.empty() && options.poses != PoseEstimator::kNone) {
    const auto pose_model = ModelBundle::open(options.pose_model);
    if (!pose_model.options().geometry_head.predicts_rays() || !pose_model.has(BundlePart::geometry_head())) {
      fail({"--pose-model", "a bundle with a geometry head that sees cameras",
            pose_model.folder().string() + ", which has none", "choose a DA3 or VGGT model"});
    }
    models.pose_model = kept_bundle_models(pose_model, device);
    seeing = pose_model.options().geometry_head;
  }
  const std::string head = seeing.predicts_rays() ? seeing.architecture().kind() : "";
  if (options.poses == PoseEstimator::kDa3Decoder &&
      (head.empty() || !seeing.architecture().decodes_cameras())) {
    fail({"--poses da3_decoder", "a model with DA3's camera decoder",
          head.empty() ? "none" : "the head of kind " + head + " without one",
          "name a bundle with dpt_head.camera_decoder: true with --pose-model, or choose another estimator"});
  }
  if (options.poses == PoseEstimator::kVggt && head != "vggt") {
    fail({"--poses vggt", "a model with VGGT's camera head",
          head.empty() ? "none" : "the head of kind " + head,
          "name a VGGT bundle with --pose-model, or choose another estimator"});
  }
  return models;
}

// Returns a text that changes with the weights of all models of an evaluation.
std::string content_of_models(const EvaluationOptions& options, const ModelBundle& bundle) {
  std::string content = bundle.content_hash();
  if (!options.pose_model.empty() && std::filesystem::is_directory(options.pose_model))
    content += " " + ModelBundle::open(options.pose_model).content_hash();
  for (const std::string& file : {options.lpips.lpips_backbone, options.lpips.lpips_heads}) {
    if (std::filesystem::is_regular_file(file)) content += " " + sha256_of_file(file);
  }
  return content;
}

// Evaluates a scene with each number of sources; draws the sheet of the first.
MeasuredScene measured_scene(const EvaluationModels& models, const EvaluationOptions& options,
                             const Scene& scene, int64_t index) {
  const FlowSettings sampling = flow_settings(options.sampling_method(), options.guidance, models.bundle);
  MeasuredScene measured;
  for (const ViewSelection& selection :
       evaluated_views(options.evaluated_views(), scene, held_out_key(options.synthetic_seed, index))) {
    const SamplingScene loaded = load_selected_views(scene, selection, models.bundle);
    for (const std::string& warning : loaded.warnings) {
      if (std::find(measured.kept.warnings.begin(), measured.kept.warnings.end(), warning) ==
          measured.kept.warnings.end())
        measured.kept.warnings.push_back(warning);
    }
    const auto seeds = noise_seeds(options, index);
    const EvaluatedScene evaluated = evaluate_scene(models, loaded, sampling, seeds);
    if (measured.kept.by_count.empty()) {
      if (options.pictures > 0) measured.sheet = encode_png(scene_sheet(loaded, evaluated), {});
      if (!options.attention_times.empty()) {
        measured.kept.attention =
            attention_correspondence(models, loaded, options.attention_times, seeds.front());
      }
    }
    measured.kept.by_count.push_back(evaluated.evaluation);
  }
  return measured;
}

// Returns the bytes of a measured scene on its way to the process that keeps it.
std::string bytes_of(const MeasuredScene& scene, const RecordOf& of) {
  const std::vector<uint8_t> sheet(scene.sheet.begin(), scene.sheet.end());
  const auto bytes = nlohmann::json::to_cbor(
      {{"record", text_of(scene.kept, of)}, {"sheet", nlohmann::json::binary(sheet)}});
  return {bytes.begin(), bytes.end()};
}

std::string progress_note(const KeptScene& scene) {
  const SceneEvaluation& first = scene.by_count.front();
  return fmt::format("PSNR of the sample {:.2f} dB, of the mean prediction {:.2f} dB",
                     first.number("sample_psnr").value, first.number("mean_prediction_psnr").value);
}

// Returns the scenes that the run folder of rank 0 does not have yet; they are the same at every process.
std::vector<int64_t> scenes_to_measure(const ProcessShare& share, const SceneRecords* records,
                                       int64_t count) {
  std::vector<int64_t> missing;
  for (int64_t index = 0; records != nullptr && index < count; ++index) {
    if (!records->find(index)) missing.push_back(index);
  }
  return nlohmann::json::parse(share.team->gather(nlohmann::json(missing).dump()).front())
      .get<std::vector<int64_t>>();
}

// Measures the scenes that have no record yet; records is null at processes other than rank 0.
void measure_scenes(const ProcessShare& share, const EvaluationOptions& options,
                    const EvaluationModels& models, const Dataset& dataset,
                    const std::function<RecordOf(int64_t)>& record_of, const SceneRecords* records) {
  const auto missing = scenes_to_measure(share, records, dataset.size());
  int64_t done = dataset.size() - static_cast<int64_t>(missing.size());
  std::optional<Progress> progress;
  if (share.leads()) progress.emplace(ProgressOf{"evaluating", dataset.size(), done, options.out});
  PieceOfWork scenes;
  scenes.make = [&](int64_t index) {
    stop_if_interrupted("evaluation stopped after " + std::to_string(done) +
                        " scenes; --resume goes on with the next one");
    return bytes_of(measured_scene(models, options, dataset.scene(index), index), record_of(index));
  };
  scenes.take = [&](int64_t index, const std::string& made) {
    ++done;
    if (!share.leads()) return;
    const auto measured = nlohmann::json::from_cbor(made);
    const auto text = measured.at("record").get<std::string>();
    const auto& sheet = measured.at("sheet").get_binary();
    records->write(index, text, {sheet.begin(), sheet.end()});
    progress->update(done, progress_note(scene_of(text, record_of(index), "a measured scene").value()));
  };
  share_pieces(share, missing, scenes);
  if (progress) progress->finish();
}

// File systems take names of at most 255 bytes: of a longer one the beginning stands before its scene's number.
std::string name_of_sheet(const std::string& scene, size_t index) {
  constexpr size_t kMost = 200;
  return scene.size() <= kMost ? scene : fmt::format("{}_{:06}", scene.substr(0, kMost), index);
}

// Writes contact sheets of the first scenes, and of those with the best, the median and the worst PSNR.
void write_sheets(const EvaluationOptions& options, const RunFolder& folder, const SceneRecords& records,
                  const std::vector<SceneEvaluation>& results) {
  const auto sheets = folder.subfolder("sheets");
  for (size_t i = 0; i < results.size() && static_cast<int64_t>(i) < options.pictures; ++i) {
    copy_sheet(records.sheet(static_cast<int64_t>(i)),
               sheets / (name_of_sheet(results[i].scene, i) + ".png"));
  }
  for (const auto& [name, index] : chosen_scenes(results)) {
    copy_sheet(records.sheet(static_cast<int64_t>(index)), folder.path() / (name + "_scene.png"));
  }
  for (size_t i = 0; i < results.size(); ++i) std::filesystem::remove(records.sheet(static_cast<int64_t>(i)));
}

void write_attention(const EvaluationOptions& options, const RunFolder& folder,
                     const std::vector<std::vector<AttentionCorrespondence>>& scenes) {
  if (options.attention_times.empty()) return;
  write_file_atomically(folder.path() / "attention_pck.csv", attention_csv(scenes));
  const Figure picture = attention_picture(scenes);
  if (!picture.panels.empty()) write_png(picture, folder.subfolder("plots") / "attention_pck.png");
}

// Returns what of a run is the same for all numbers of sources, and the summaries of each, the first one's outermost.
nlohmann::ordered_json summaries(const std::vector<std::vector<SceneEvaluation>>& by_count) {
  auto report = evaluation_summary(by_count.front());
  if (by_count.size() == 1) return report;
  auto& by_sources = report["by_sources"] = nlohmann::ordered_json::object();
  for (const auto& scenes : by_count) {
    by_sources[std::to_string(scenes.front().sources.size())] = evaluation_summary(scenes);
  }
  return report;
}

// Prints the first few; all are in report.json.
void print_some(const std::vector<std::string>& warnings) {
  constexpr size_t kMost = 5;
  std::vector<std::string> some(
      warnings.begin(), warnings.begin() + static_cast<std::ptrdiff_t>(std::min(kMost, warnings.size())));
  if (warnings.size() > kMost)
    some.push_back(fmt::format("{} more warnings of scenes are in report.json.", warnings.size() - kMost));
  print_warnings(some);
}

}  // namespace

std::string evaluate(const EvaluationOptions& options) {
  const ProcessShare share = join_others(options.processes);
  use_threads(share.threads(options.threads));
  const EarlierRun earlier = options.resume ? EarlierRun::kContinue : earlier_run(options.overwrite);
  if (share.leads()) {
    check_run_folder(options.out, "eval", earlier);
    if (options.resume) refuse_other_options(options.out, options, EvaluationOptions(), {"pictures"});
  }
  const auto bundle = ModelBundle::open(options.model);
  if (!share.team->alone()) check_same_work(*share.team, options, bundle.content_hash());
  if (options.refine) {
    require_sample_refiner(bundle.options());
    bundle.require({BundlePart::refiner()});
  }
  std::vector<BundlePart> parts;
  for (const auto& part : bundle_parts(bundle.options())) {
    if (bundle.has(part) && (options.refine || !(part == BundlePart::refiner()))) parts.push_back(part);
  }
  const auto mixed = mixed_parts(bundle, parts, options.allow_mixed);
  if (share.leads()) {
    print_warnings(thread_warnings(options.threads));
    print_warnings(mixed);
  }
  const auto dataset =
      held_out_dataset(options.scenes, options.generator, options.synthetic_seed, options.synthetic);
  const EvaluationModels models =
      load_models(options, bundle, device_from_text(share.device(options.device)));
  const std::string content = content_of_models(options, bundle);
  const auto record_of = [&](int64_t index) { return RecordOf{content, dataset->scene_name(index)}; };
  std::optional<RunFolder> lead_folder;
  std::optional<SceneRecords> lead_records;
  if (share.leads()) {
    lead_folder.emplace(options.out, "eval", options, earlier);
    lead_records.emplace(lead_folder->subfolder("scenes"), record_of);
  }
  measure_scenes(share, options, models, *dataset, record_of, lead_records ? &*lead_records : nullptr);
  if (!share.leads()) return {};
  RunFolder& folder = *lead_folder;
  const SceneRecords& records = *lead_records;
  const SamplingMethod method = options.sampling_method();

  std::vector<std::vector<SceneEvaluation>> by_count(std::max<size_t>(1, options.source_counts.size()));
  std::vector<std::vector<AttentionCorrespondence>> attention;
  std::vector<std::string> warnings;
  DistinctNames names;
  for (int64_t index = 0; index < dataset->size(); ++index) {
    const KeptScene kept = records.find(index).value();
    // What compares runs scene by scene needs to tell them apart.
    const std::string name = names.of(kept.by_count.front().scene);
    for (size_t i = 0; i < by_count.size(); ++i) {
      by_count[i].push_back(kept.by_count.at(i));
      by_count[i].back().scene = name;
    }
    if (!options.attention_times.empty()) attention.push_back(kept.attention);
    for (const std::string& warning : kept.warnings) warnings.push_back(fmt::format("{}: {}", name, warning));
  }

  std::vector<SceneEvaluation> all;
  for (const auto& scenes : by_count) all.insert(all.end(), scenes.begin(), scenes.end());
  write_file_atomically(folder.path() / "eval.csv", evaluation_csv(all));
  write_file_atomically(folder.path() / "targets.csv", targets_csv(all));
  for (const MetricPicture& picture : metric_pictures(by_count.front())) {
    write_png(picture.figure, folder.subfolder("plots") / (picture.name + ".png"));
  }
  write_attention(options, folder, attention);
  if (options.pictures > 0) write_sheets(options, folder, records, by_count.front());
  nlohmann::ordered_json report = {{"command", "eval"},
                                   {"model", options.model},
                                   {"model_hash", bundle.content_hash()},
                                   {"precision", precision_text(options.precision, options.device)},
                                   {"methods", methods_json(method, options)},
                                   {"protocol", protocol_json(options, bundle.options())}};
  const auto summary = summaries(by_count);
  report.update(summary);
  report["warnings"] = warnings;
  print_some(warnings);
  folder.write_report(report);
  folder.note("table", "eval.csv");
  folder.note("a row a target", "targets.csv");
  if (!options.attention_times.empty()) folder.note("queries and keys", "attention_pck.csv");
  folder.note("report", "report.json");
  if (by_count.front().size() > 1) folder.note("plots", "plots");
  if (options.pictures > 0) folder.note("pictures", "sheets");
  if (options.json) return json_text(report, 2) + "\n";
  std::string text;
  if (by_count.size() == 1) text = evaluation_text(summary);
  for (const auto& scenes : by_count) {
    if (by_count.size() == 1) break;
    text += fmt::format("## {} sources\n\n", scenes.front().sources.size()) +
            evaluation_text(summary.at("by_sources").at(std::to_string(scenes.front().sources.size()))) +
            "\n";
  }
  return text + folder.closing_box();
}

}  // namespace gld
