#include "train/stages/training_stage.h"

#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/option_differences.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "models/bundle/part_lineage.h"
#include "models/bundle/trained_views.h"
#include "train/distributed/process_team.h"

#include <algorithm>
#include <iostream>
#include <optional>
#include <set>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

DType file_dtype_of(ExportPrecision precision) {
  switch (precision) {
    case ExportPrecision::kFloat16:
      return DType::kFloat16;
    case ExportPrecision::kBFloat16:
      return DType::kBFloat16;
    case ExportPrecision::kFloat32:
      break;
  }
  return DType::kFloat32;
}

}  // namespace

void TrainOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "bundle folder: model.yaml and the parts trained before"}, model);
  visit_out(visitor, out, overwrite);
  visitor.boolean({"resume", "continue the run in the run folder"}, resume);
  visitor.texts({"may_change", "options that may differ from those of the run that --resume continues"},
                may_change);
  visitor.boolean({"allow_mixed", "take parts that were not trained on each other"}, allow_mixed);
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visit_choice(visitor, {"weights", "precision of the exported weights"}, weights,
               {"float32", "float16", "bfloat16"});
  visitor.group(
      {"processes", "several processes that train together; torchrun sets the environment that is meant"},
      processes);
  visitor.group({"data", "what to train on"}, data);
  visitor.group({"loop", "steps, optimiser, checkpoints"}, loop);
}

void TrainOptions::check() const {
  if (model.empty()) {
    fail({"--model", "a bundle folder with a model.yaml", "nothing", "add for example --model configs/tiny"});
  }
  check_out(out, "runs/train");
  if (resume && overwrite) {
    fail({"--resume, --overwrite", "one of the two", "both",
          "--resume goes on with the run, --overwrite removes it"});
  }
}

void refuse_changed_options(const std::filesystem::path& folder, const OptionsGroup& now,
                            const std::vector<std::string>& may_change) {
  const std::set<std::string> free = {"model",
                                      "device",
                                      "weights",
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
                                      "loop.learning_rate.schedule",
                                      "loop.learning_rate.warmup_steps",
                                      "loop.learning_rate.decay_start_step",
                                      "loop.learning_rate.decay_end_step",
                                      "objective.start",
                                      "objective.flow.start",
                                      "objective.training"};
  const auto contains = [](const auto& names, const std::string& name) {
    return std::find(names.begin(), names.end(), name) != names.end();
  };
  const auto file = folder / "config.yaml";
  if (!std::filesystem::is_regular_file(file)) return;  // killed before it was written
  std::string before, here, keys;
  for (const auto& difference : differences_from(read_file(file), file.string(), now)) {
    if (free.count(difference.key) > 0 || contains(options_beside_the_result(), difference.key) ||
        difference.key.rfind("processes.", 0) == 0 || contains(may_change, difference.key)) {
      continue;
    }
    const std::string separator = keys.empty() ? "" : ", ";
    before += separator + difference.key + " " + difference.before;
    here += separator + difference.now;
    keys += (keys.empty() ? "" : ",") + difference.key;
  }
  if (keys.empty()) return;
  fail({"--resume", "the options that the run was begun with (" + before + ")", here,
        "leave them as they were, or allow it with --may-change " + keys});
}

// Parts of the bundle that the run did not make itself.
void copy_other_parts(const ModelBundle& from, const std::filesystem::path& to,
                      const std::vector<BundlePart>& made) {
  const auto target = ModelBundle::open(to);
  for (const BundlePart& part : bundle_parts(from.options())) {
    if (!from.has(part) || std::find(made.begin(), made.end(), part) != made.end()) continue;
    copy_file_atomically(from.file(part), target.file(part));
  }
}

void note_what_was_trained_on(const ModelBundle& bundle, const std::vector<BundlePart>& made) {
  for (const BundlePart& part : bundle_parts(bundle.options())) {
    if (std::find(made.begin(), made.end(), part) != made.end()) note_trained_on(bundle, part);
  }
}

namespace {

// Options that processes which train together may differ in.
bool is_of_one_process(const std::string& key) {
  const auto& beside = options_beside_the_result();
  return key.rfind("processes.", 0) == 0 || std::find(beside.begin(), beside.end(), key) != beside.end();
}

// Throws the same Error at every process where one would not train what rank 0 trains.
void check_same_work(ProcessTeam& team, const OptionsGroup& options, const ModelBundle& bundle) {
  const nlohmann::json mine = {{"options", to_yaml(options)}, {"model", bundle.content_hash()}};
  const auto first = nlohmann::json::parse(team.gather(mine.dump()).front());
  std::string of_first, here;
  for (const auto& difference : differences_from(first.at("options").get<std::string>(), "rank 0", options)) {
    if (is_of_one_process(difference.key)) continue;
    const std::string separator = here.empty() ? "" : ", ";
    of_first += separator + difference.key + " " + difference.before;
    here += separator + difference.now;
  }
  nlohmann::json complaint;
  if (!here.empty()) {
    complaint = {"the options of rank 0 (" + of_first + ")", here,
                 "start every process with the same options"};
  } else if (mine.at("model") != first.at("model")) {
    complaint = {"the model files that rank 0 has", "others in the folder of --model",
                 "copy those of rank 0 there, model.yaml included"};
  }
  const auto complaints = team.gather(complaint.dump());
  for (size_t rank = 0; rank < complaints.size(); ++rank) {
    const auto said = nlohmann::json::parse(complaints[rank]);
    if (said.is_null()) continue;
    fail({"rank " + std::to_string(rank), said.at(0).get<std::string>(), said.at(1).get<std::string>(),
          said.at(2).get<std::string>()});
  }
}

// Threads are shared by the processes of a machine.
int64_t threads_of_process(int64_t threads, const ProcessTeam* team) {
  if (threads > 0 || team == nullptr) return threads;
  return std::max<int64_t>(1, threads_to_use(0) / team->local_count());
}

}  // namespace

std::string run_training_stage(const TrainOptions& options, const OptionsGroup& all_options,
                               const TrainingStage& stage, const DrawValidation& draw) {
  const ProcessPlacement processes = process_placement(options.processes, variable_of_this_process);
  std::unique_ptr<ProcessTeam> team;
  if (processes.count > 1) team = join_processes(processes);
  const bool leads = team == nullptr || team->rank() == 0;
  use_threads(threads_of_process(options.threads, team.get()));
  if (leads) print_warnings(thread_warnings(options.threads));
  EarlierRun earlier = earlier_run(options.overwrite);
  if (options.resume) earlier = EarlierRun::kContinue;
  const auto start = options.resume ? TrainingStart::kResume : TrainingStart::kFresh;
  if (leads) {
    if (!options.overwrite) check_training_start(options.out, start);
    check_run_folder(options.out, stage.command, earlier);
    if (options.resume) refuse_changed_options(options.out, all_options, options.may_change);
  }
  const auto bundle = ModelBundle::open(options.model);
  if (team != nullptr) check_same_work(*team, all_options, bundle);
  ParameterPlacement placement;
  const bool device_each = team != nullptr && options.device == "cuda";
  placement.device =
      device_from_text(device_each ? "cuda:" + std::to_string(processes.local_rank) : options.device);
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
  const auto sizes = bundle.options().image_sizes();
  const auto data = std::make_shared<DatasetBatches>(options.data, sizes, stage.parts);

  TrainingRun run;
  run.team = team.get();
  run.objective = objective.get();
  run.data = data;
  run.folder = options.out;
  run.export_dtype = file_dtype_of(options.weights);
  run.draw_validation = draw;
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
  run.validation_scenes = validation_scenes(options.data, sizes.front(), stage.parts);
  if (team != nullptr) {
    std::cerr << "note: " << team->count()
              << " processes; micro-batch i of a step is computed by rank i modulo " << team->count() << "\n";
  }
  const TrainingSummary summary = train(run, options.loop, start);
  copy_other_parts(bundle, folder.path() / "model", stage.made);
  const auto trained = ModelBundle::open(folder.path() / "model");
  note_what_was_trained_on(trained, stage.made);
  for (const auto& part : stage.made) {
    if (part.kind == BundlePart::Kind::kGenerator)
      note_trained_views(trained, part, options.data.views.views);
  }

  nlohmann::ordered_json report = {{"command", stage.command},
                                   {"parameters", parameters},
                                   {"steps", summary.steps_done},
                                   {"steps_in_this_call", summary.steps_this_call},
                                   {"skipped_steps", summary.skipped_steps},
                                   {"seconds", summary.seconds},
                                   {"final_loss", summary.final_loss}};
  for (const auto& [name, value] : summary.validation) report["validation"][name] = value;
  const LoadingReport loading = data->report();
  report["data"] = {{"broken_samples", loading.broken_samples},
                    {"pose_outliers", loading.pose_outliers},
                    {"short_scenes", loading.short_scenes},
                    {"last_problem", loading.last_problem}};
  report["messages"] = summary.messages;
  folder.write_report(report);
  for (const std::string& message : summary.messages) std::cerr << "note: " << message << '\n';
  folder.note("model", "model");
  folder.note("loss curve", "loss.png");
  folder.note("metrics", "metrics.jsonl");
  folder.note("report", "report.json");
  return folder.closing_box();
}

}  // namespace gld
