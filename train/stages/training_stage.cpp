#include "train/stages/training_stage.h"

#include "gld/base/atomic_folder.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"

#include <algorithm>
#include <iostream>

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
  visit_out(visitor, out);
  visitor.boolean({"resume", "continue the run in the run folder"}, resume);
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visit_choice(visitor, {"weights", "precision of the exported weights"}, weights,
               {"float32", "float16", "bfloat16"});
  visitor.group({"data", "what to train on"}, data);
  visitor.group({"loop", "steps, optimiser, checkpoints"}, loop);
}

void TrainOptions::check() const {
  if (model.empty()) {
    fail({"--model", "a bundle folder with a model.yaml", "nothing", "add for example --model configs/tiny"});
  }
  check_out(out, "runs/train");
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

std::string run_training_stage(const TrainOptions& options, const OptionsGroup& all_options,
                               const TrainingStage& stage, const DrawValidation& draw) {
  install_interrupt_handler();
  use_threads(options.threads);
  const auto bundle = ModelBundle::open(options.model);
  ParameterPlacement placement;
  placement.device = device_from_text(options.device);
  const auto start = options.resume ? TrainingStart::kResume : TrainingStart::kFresh;
  check_training_start(options.out, start);
  const auto objective = stage.objective(bundle, placement);
  const auto sizes = bundle.options().image_sizes();
  const auto data = std::make_shared<DatasetBatches>(options.data, sizes, stage.parts);

  RunFolder folder(options.out, stage.command, all_options);
  TrainingRun run;
  run.folder = folder.path();
  run.objective = objective.get();
  run.data = data;
  run.validation_scenes = validation_scenes(options.data, sizes.front(), stage.parts);
  run.export_dtype = file_dtype_of(options.weights);
  run.draw_validation = draw;
  int64_t parameters = 0;
  for (const auto& item : objective->parameters()) parameters += item.parameter.numel();

  const TrainingSummary summary = train(run, options.loop, start);
  copy_other_parts(bundle, folder.path() / "model", stage.made);

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
