#include "train/stages/latent_stages.h"

#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/latents/latent_statistics.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "models/layers/imagenet.h"
#include "train/objectives/level_objective.h"

#include <iostream>

#include <torch/autograd.h>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

FrozenParts frozen_parts(const ModelBundle& bundle, const ParameterPlacement& placement) {
  FrozenParts frozen;
  frozen.backbone = bundle.load_backbone(placement);
  frozen.boundary_statistics = bundle.load_statistics(BundlePart::kStatisticsLevel1).to(placement.device);
  if (bundle.has(BundlePart::kRgbDecoder)) frozen.rgb_decoder = bundle.load_rgb_decoder(placement);
  return frozen;
}

void tell_narrow_decoder(const char* model, const DitOptions& options) {
  const auto note = narrow_decoder_note(options);
  if (!note.empty()) std::cerr << "note: " << model << '.' << note << '\n';
}

}  // namespace

void TrainLevelOptions::visit(FieldVisitor& visitor) {
  TrainOptions::visit(visitor);
  visitor.integer({"level", "level to generate, the model's boundary level"}, level, {1, 16});
  visitor.group({"objective", "flow matching"}, objective);
}

void TrainCascadeOptions::visit(FieldVisitor& visitor) {
  TrainOptions::visit(visitor);
  visitor.group({"objective", "flow matching and noise on the deeper level"}, objective);
}

std::string train_level(const TrainLevelOptions& options, const DrawValidation& draw) {
  TrainingStage stage;
  stage.command = "train level";
  stage.made = {BundlePart::kLevel1};
  stage.objective = [&options](const ModelBundle& bundle, const ParameterPlacement& placement) {
    if (options.level != bundle.options().boundary_level) {
      fail({"--level",
            std::to_string(bundle.options().boundary_level) + ", the boundary_level of " + options.model,
            std::to_string(options.level), "change boundary_level in model.yaml and compute its statistics"});
    }
    tell_narrow_decoder("level1", bundle.options().level1);
    auto objective = std::make_unique<LevelObjective>(
        bundle.options(), options.objective, frozen_parts(bundle, placement), placement, options.loop.seed);
    if (options.objective.start == FlowStart::kBundle) {
      objective->start_from(*bundle.load_level1(placement));
    }
    return objective;
  };
  return run_training_stage(options, options, stage, draw);
}

std::string train_cascade(const TrainCascadeOptions& options, const DrawValidation& draw) {
  TrainingStage stage;
  stage.command = "train cascade";
  stage.made = {BundlePart::kCascade};
  stage.objective = [&options](const ModelBundle& bundle, const ParameterPlacement& placement) {
    tell_narrow_decoder("cascade", bundle.options().cascade);
    FrozenParts frozen = frozen_parts(bundle, placement);
    frozen.level0_statistics = bundle.load_statistics(BundlePart::kStatisticsLevel0).to(placement.device);
    auto objective = std::make_unique<CascadeObjective>(bundle.options(), options.objective,
                                                        std::move(frozen), placement, options.loop.seed);
    if (options.objective.flow.start == FlowStart::kBundle) {
      objective->start_from(*bundle.load_cascade(placement));
    }
    return objective;
  };
  return run_training_stage(options, options, stage, draw);
}

StatsOptions::StatsOptions() { data.validation_scenes = 0; }

void StatsOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "bundle folder with a trained backbone"}, model);
  visit_out(visitor, out);
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visitor.integer({"scene_count", "training scenes to look at"}, scene_count, {1, 1'000'000'000});
  visitor.group({"data", "the training data"}, data);
}

void StatsOptions::check() const {
  if (model.empty()) {
    fail({"--model", "a bundle folder with a trained backbone", "nothing",
          "add for example --model configs/tiny"});
  }
  check_out(out, "runs/stats");
}

std::string compute_statistics(const StatsOptions& options) {
  const torch::NoGradGuard no_grad;
  install_interrupt_handler();
  use_threads(options.threads);
  const auto bundle = ModelBundle::open(options.model);
  ParameterPlacement placement;
  placement.device = device_from_text(options.device);
  const BundleOptions& model = bundle.options();
  const auto backbone = bundle.load_backbone(placement);
  const DatasetBatches data(options.data, model.image_sizes(), FrameParts::kImage);
  RunFolder folder(options.out, "stats", options);

  const auto boundary = static_cast<size_t>(model.boundary_level);
  StreamingMoments level0(model.backbone.level_channels()), deeper(model.backbone.level_channels());
  Progress progress("latent statistics", options.scene_count);
  int64_t scenes = 0;
  for (int64_t index = 0; scenes < options.scene_count; ++index) {
    stop_if_interrupted("statistics stopped after " + std::to_string(scenes) +
                        " scenes; nothing was written");
    for (const TrainingScene& on_host : data.batch(index).scenes) {
      if (scenes == options.scene_count) break;
      const TrainingScene scene = on_host.to(placement.device);
      const auto levels = backbone->encode(imagenet_normalise(scene.images), model.boundary_level);
      const auto patches = [](const torch::Tensor& level) { return level.narrow(1, 1, level.size(1) - 1); };
      add_features(level0, patches(levels[0]));
      add_features(deeper, patches(levels[boundary]));
      progress.update(++scenes);
    }
  }
  progress.finish();

  const auto made = folder.path() / "model";
  save_bundle_options(made, model);
  copy_other_parts(bundle, made, {BundlePart::kStatisticsLevel0, BundlePart::kStatisticsLevel1});
  const auto statistics0 = statistics_of(level0, model.latent_epsilon);
  const auto statistics_deeper = statistics_of(deeper, model.latent_epsilon);
  save_bundle_part(made, BundlePart::kStatisticsLevel0, statistics_tensors(statistics0));
  save_bundle_part(made, BundlePart::kStatisticsLevel1, statistics_tensors(statistics_deeper));

  const auto summary = [](const LatentStatistics& statistics) {
    const auto deviation = statistics.variance.sqrt();
    return nlohmann::ordered_json{{"largest_mean", statistics.mean.abs().max().item<double>()},
                                  {"smallest_deviation", deviation.min().item<double>()},
                                  {"largest_deviation", deviation.max().item<double>()}};
  };
  folder.write_report({{"command", "stats"},
                       {"scenes", scenes},
                       {"tokens", level0.count()},
                       {"level0", summary(statistics0)},
                       {"boundary_level", model.boundary_level},
                       {"boundary", summary(statistics_deeper)}});
  folder.note("model", "model");
  folder.note("report", "report.json");
  return folder.closing_box();
}

}  // namespace gld
