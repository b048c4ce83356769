#include "train/stages/training_stage.h"

#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/option_differences.h"
#include "gld/base/sha256.h"
#include "gld/distributed/shared_work.h"
#include "gld/machine/precision_option.h"
#include "gld/page/run_page.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "gld/tensors/torch_version.h"
#include "models/bundle/part_lineage.h"
#include "models/bundle/seen_scenes.h"
#include "models/bundle/trained_views.h"
#include "models/bundle/view_unit_file.h"
#include "train/page/live_training_page.h"

#include <algorithm>
#include <iostream>
#include <optional>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace gld {

namespace {

void check_loop(const TrainingLoopOptions& loop) {
  const LearningRateOptions& rate = loop.learning_rate;
  const int64_t start = std::max(rate.warmup_steps, rate.decay_start_step);
  const int64_t end = rate.decay_end_step > 0 ? rate.decay_end_step : loop.steps;
  if (rate.schedule != LearningRateSchedule::kConstant && rate.decay_end_step > 0 && end <= start) {
    fail({"--decay-end-step", "a step behind the decay's beginning, " + std::to_string(start),
          std::to_string(end), "raise it, or lower --decay-start-step or --warmup-steps"});
  }
  if (loop.workers > loop.micro_batches) {
    fail({"--loop.workers", "at most --loop.micro-batches, " + std::to_string(loop.micro_batches),
          std::to_string(loop.workers), "the others would have nothing to compute"});
  }
  if (loop.shard_optimiser && loop.optimiser.algorithm == OptimiserAlgorithm::kMuon) {
    fail({"--shard-optimiser", "adamw or adam, which move each number by itself",
          "muon, which moves whole matrices", "choose one of them, or leave the optimiser whole"});
  }
}

// What is written is the moving average, which a short run hardly moves; and the rate has a course.
std::vector<std::string> warnings_of_short_runs(const TrainingLoopOptions& loop) {
  std::vector<std::string> warnings;
  const double decay = loop.optimiser.ema_decay;
  if (decay > 0 && decay < 1 && static_cast<double>(loop.steps) * (1 - decay) < 1) {
    warnings.push_back(fmt::format(
        "the model that is written is a moving average over about {:.0f} steps "
        "(loop.optimiser.ema_decay {}), and this run has {}: it will hardly differ from what it begins "
        "with; lower ema_decay, or train longer",
        1 / (1 - decay), decay, loop.steps));
  }
  const LearningRateOptions& rate = loop.learning_rate;
  if (rate.warmup_steps > loop.steps) {
    warnings.push_back(fmt::format(
        "the learning rate grows for {} steps (loop.learning_rate.warmup_steps), and this run has {}: it ends before "
        "the peak; lower warmup_steps, or train longer",
        rate.warmup_steps, loop.steps));
  } else if (rate.schedule != LearningRateSchedule::kConstant && rate.decay_start_step >= loop.steps) {
    warnings.push_back(fmt::format(
        "the learning rate falls from step {} on (loop.learning_rate.decay_start_step), and this run has {}: it "
        "never falls; lower decay_start_step, or train longer",
        rate.decay_start_step, loop.steps));
  }
  return warnings;
}

// This checks the keys, as "foo" would silently allow nothing.
void check_may_change(const StageOptions& options, const OptionsGroup& all_options,
                      const BundleOptions& model) {
  std::vector<std::string> keys;
  for (const auto& option : describe_options(all_options)) keys.push_back(option.key);
  for (const auto& option : describe_options(model)) keys.push_back("model." + option.key);
  for (const auto& key : options.may_change) {
    if (std::find(keys.begin(), keys.end(), key) != keys.end()) continue;
    const auto near = nearest_name(key, keys);
    fail({"--may-change", "names of options, such as loop.steps", "'" + key + "'",
          near.empty() ? "see config.yaml of the run" : "did you mean '" + near + "'?"});
  }
}

}  // namespace

void StageOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "bundle folder: model.yaml and the parts trained before"}, model);
  visit_out(visitor, out, overwrite);
  visitor.boolean({"resume", "continue the run in the run folder"}, resume);
  visitor.texts({"may_change", "options that may differ from those of the run that --resume continues"},
                may_change);
  visitor.boolean({"allow_mixed", "take parts that were not trained on each other"}, allow_mixed);
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visit_store(visitor, store);
  visitor.group(
      {"processes", "several processes that train together; torchrun sets the environment that is meant"},
      processes);
  visit_data(visitor);
  visitor.group({"loop", "steps, optimiser, checkpoints"}, loop);
}

void TrainOptions::visit_data(FieldVisitor& visitor) {
  visitor.group({"data", "what to train on"}, data);
  visitor.text(
      {"kept_scenes",
       "folder where rooms, and what frozen parts make of scenes, are kept for other runs of this build, as "
       "far as they come again (data.distinct_batches)"},
      kept_scenes);
}

std::shared_ptr<const KeptFolder> kept_scene_folder(const TrainOptions& options, const ModelBundle& bundle,
                                                    const std::vector<BundlePart>& frozen,
                                                    const torch::Device& device, const std::string& use) {
  if (options.kept_scenes.empty() || options.data.distinct_batches == 0) return nullptr;
  const BundleOptions& model = bundle.options();
  std::string made_of =
      use + '\n' + to_yaml(model.backbone) + to_yaml(model.geometry_head) + to_yaml(model.depth_refinement) +
      fmt::format("boundary {}, epsilon {}, unit {} {}\n", model.boundary_level, model.latent_epsilon,
                  model.single_source_unit, model.single_source_unit_deviation);
  for (const BundlePart& part : frozen) {
    if (bundle.has(part)) made_of += bundle_part_name(part) + ' ' + sha256_of_file(bundle.file(part)) + '\n';
  }
  const auto unit = bundle.folder() / kSingleViewUnitFile;
  if (std::filesystem::is_regular_file(unit)) made_of += "single view unit " + sha256_of_file(unit) + '\n';
  // Libraries are not in the executable, whose hash the folder knows.
  made_of += std::string(device.is_cpu() ? "cpu" : "device") + ", LibTorch " + torch_version() + ", " +
             blas_text() + '\n';
  return std::make_shared<const KeptFolder>(options.kept_scenes, made_of);
}

TrainingStage scene_stage(const std::string& command, const TrainOptions& options, FrameParts parts) {
  TrainingStage stage;
  stage.command = command;
  stage.views = options.data.views.views;
  stage.data = [&options, parts](const ModelBundle& bundle) {
    const auto sizes = bundle.options().image_sizes();
    const auto batches = std::make_shared<DatasetBatches>(options.data, sizes, parts);
    if (!options.kept_scenes.empty()) batches->keep_in(options.kept_scenes);
    StageData data;
    data.batches = batches;
    data.validation = [&options, parts, size = sizes.front()] {
      const TrainingDataOptions& given = options.data;
      if (!given.scenes.empty() && given.validation_folder.empty() && given.validation_scenes > 0) {
        std::cerr << fmt::format(
            "note: validation is on {} drawn rooms, not on your scenes; give some that are not trained on with "
            "--validation-folder\n",
            given.validation_scenes);
      }
      auto scenes = validation_scenes(options.data, size, parts);
      if (static_cast<int64_t>(scenes.size()) < given.validation_scenes) {
        std::cerr << fmt::format("note: validation is on the {} scenes that {} has, not on {}\n",
                                 scenes.size(), given.validation_folder, given.validation_scenes);
      }
      return scenes;
    };
    data.report = [batches] {
      const LoadingReport loading = batches->report();
      return nlohmann::ordered_json{{"broken_samples", loading.broken_samples},
                                    {"pose_outliers", loading.pose_outliers},
                                    {"short_scenes", loading.short_scenes},
                                    {"last_problem", loading.last_problem}};
    };
    return data;
  };
  return stage;
}

void StageOptions::check() const {
  if (model.empty() && resume) {
    fail({"--resume", "the options that the run was begun with", "no --model",
          fmt::format("add --config {}/config.yaml, where they stand", out.empty() ? "RUN" : out)});
  }
  if (model.empty()) {
    fail({"--model", "a bundle folder with a model.yaml", "nothing", "add for example --model configs/tiny"});
  }
  check_out(out, "runs/train");
  if (resume && overwrite) {
    fail({"--resume, --overwrite", "one of the two", "both",
          "--resume goes on with the run, --overwrite removes it"});
  }
  check_input_survives("--model", model, out, overwrite);
  check_loop(loop);
}

void refuse_changed_options(const std::filesystem::path& folder, const OptionsGroup& now,
                            const OptionsGroup& defaults, const std::vector<std::string>& may_change) {
  const std::set<std::string> free = {"model",
                                      "device",
                                      "store",
                                      "may_change",
                                      "allow_mixed",
                                      "loop.steps",
                                      "loop.log_every",
                                      "loop.checkpoint_every",
                                      "loop.keep_last",
                                      "loop.validate_every",
                                      "loop.stop_after_non_finite",
                                      "loop.loader_threads",
                                      "loop.workers",
                                      "loop.shard_optimiser",
                                      "loop.learning_rate.schedule",
                                      "loop.learning_rate.warmup_steps",
                                      "loop.learning_rate.decay_start_step",
                                      "loop.learning_rate.decay_end_step",
                                      "objective.start",
                                      "objective.kept_gib",
                                      "objective.kept_latents_gib",
                                      "objective.flow.kept_latents_gib",
                                      "objective.flow.start",
                                      "objective.training"};
  const auto file = folder / "config.yaml";
  if (!std::filesystem::is_regular_file(file)) return;  // killed before it was written
  constexpr size_t kNamed = 3;
  size_t count = 0;
  std::string named, keys;
  for (const auto& difference : differences_from(read_file(file), file.string(), now, &defaults)) {
    if (free.count(difference.key) > 0 || is_beside_the_result(difference.key) ||
        std::find(may_change.begin(), may_change.end(), difference.key) != may_change.end()) {
      continue;
    }
    if (++count > kNamed) continue;
    named += (named.empty() ? "" : ", ") + difference_text(difference);
    keys += (keys.empty() ? "" : ",") + difference.key;
  }
  if (count == 0) return;
  if (count > kNamed) named += fmt::format(" and {} more", count - kNamed);
  fail({"--resume", "the options that the run was begun with", named,
        count > kNamed ? fmt::format("take them from --config {}", file.string())
                       : "leave them as they were, or allow it with --may-change " + keys});
}

// Copies the parts of the bundle that the run did not make itself.
void copy_other_parts(const ModelBundle& from, const std::filesystem::path& to,
                      const std::vector<BundlePart>& made) {
  const auto target = ModelBundle::open(to);
  for (const BundlePart& part : bundle_parts(from.options())) {
    if (!from.has(part) || std::find(made.begin(), made.end(), part) != made.end()) continue;
    copy_file_atomically(from.file(part), target.file(part));
  }
  for (const char* name : {kSeenScenesFile, kSingleViewUnitFile}) {
    if (std::filesystem::is_regular_file(from.folder() / name))
      copy_file_atomically(from.folder() / name, to / name);
  }
}

void note_what_was_trained_on(const ModelBundle& bundle, const std::vector<BundlePart>& made) {
  for (const BundlePart& part : bundle_parts(bundle.options())) {
    if (std::find(made.begin(), made.end(), part) != made.end()) note_trained_on(bundle, part);
  }
}

std::string run_training_stage(const StageOptions& options, const OptionsGroup& all_options,
                               const OptionsGroup& defaults, const TrainingStage& stage,
                               const DrawValidation& draw) {
  const ProcessShare share = join_others(options.processes);
  const bool leads = share.leads();
  use_threads(share.threads(options.threads));
  if (leads) print_warnings(thread_warnings(options.threads));
  EarlierRun earlier = earlier_run(options.overwrite);
  if (options.resume) earlier = EarlierRun::kContinue;
  const auto start = options.resume ? TrainingStart::kResume : TrainingStart::kFresh;
  if (leads) {
    if (!options.overwrite) check_training_start(options.out, start);
    check_run_folder(options.out, stage.command, earlier);
    if (options.resume) refuse_changed_options(options.out, all_options, defaults, options.may_change);
  }
  const auto bundle = ModelBundle::open(options.model);
  check_may_change(options, all_options, bundle.options());
  if (!share.team->alone()) check_same_work(*share.team, all_options, bundle.content_hash());
  ParameterPlacement placement;
  placement.device = device_from_text(share.device(options.device));
  for (const auto& part : stage.made) {
    std::vector<BundlePart> others;
    for (const auto& other : trained_on(part, bundle.options())) {
      if (bundle.has(other)) others.push_back(other);
    }
    for (const auto& warning : mixed_parts(bundle, others, options.allow_mixed)) {
      if (leads) print_warnings({warning});
    }
  }
  const auto objective = stage.objective(bundle, placement);
  const StageData data = stage.data(bundle);

  TrainingRun run;
  run.team = share.team.get();
  run.objective = objective.get();
  run.data = data.batches;
  run.folder = options.out;
  run.export_dtype = stored_dtype(options.store);
  run.draw_validation = draw;
  const BundleOptions model_defaults;
  run.model = &bundle.options();
  run.model_defaults = &model_defaults;
  run.may_change = options.may_change;
  run.trained_on = hashes_of_trained_on(bundle, stage.made);
  run.allow_other_parts = options.allow_mixed;
  run.begins_trained = stage.start == ModelStart::kBundle;
  int64_t parameters = 0;
  for (const auto& item : objective->parameters()) parameters += item.parameter.numel();

  // A stop waits for the end of the step, where a checkpoint is written.
  install_interrupt_handler(StopDeadline::kSafePoint);
  if (!leads) {
    train(run, options.loop, start);
    return {};
  }
  RunFolder folder(options.out, stage.command, all_options, earlier);
  run.folder = folder.path();
  run.validation_scenes = data.validation();
  if (!share.team->alone()) {
    const int64_t processes = share.team->count();
    std::cerr << "note: " << processes << " processes; micro-batch i of a step is computed by rank i modulo "
              << processes << "\n";
  }
  const ComputePrecision precision = options.loop.precision;
  const bool on_cpu = placement.device.is_cpu();
  const std::string computed_in = precision_text(precision, placement.device.str());
  if (on_cpu && !has_matrix_unit(precision)) {
    print_warnings({"this processor has no unit for " + compute_precision_name(precision) +
                    ", which makes it slower here than --loop.precision float32"});
  }
  print_warnings(warnings_of_short_runs(options.loop));
  LiveTrainingPage page(folder.path());
  run.on_step = [&page] { page.follow(); };
  run.on_stop = [&page] { page.stop(); };
  const TrainingSummary summary = train(run, options.loop, start);
  copy_other_parts(bundle, folder.path() / "model", stage.made);
  const auto trained = ModelBundle::open(folder.path() / "model");
  note_what_was_trained_on(trained, stage.made);
  for (const auto& part : stage.made) {
    if (part.kind == BundlePart::Kind::kGenerator) note_trained_views(trained, part, stage.views);
  }

  nlohmann::ordered_json report = {{"command", stage.command},
                                   {"parameters", parameters},
                                   {"precision", computed_in},
                                   {"steps", summary.steps_done},
                                   {"steps_in_this_call", summary.steps_this_call},
                                   {"skipped_steps", summary.skipped_steps},
                                   {"seconds", summary.seconds},
                                   {"final_loss", summary.final_loss}};
  for (const auto& [name, value] : summary.validation) report["validation"][name] = value;
  if (data.report) report["data"] = data.report();
  report["messages"] = summary.messages;
  folder.write_report(report);
  page.end();
  for (const std::string& message : summary.messages) std::cerr << "note: " << message << '\n';
  folder.note("model", "model");
  if (std::filesystem::exists(folder.path() / "loss.png")) folder.note("loss curve", "loss.png");
  folder.note("metrics", "metrics.jsonl");
  folder.note("report", "report.json");
  folder.note("page", kPageFile);
  return folder.closing_box();
}

}  // namespace gld
