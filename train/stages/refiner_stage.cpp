#include "train/stages/refiner_stage.h"

#include "gld/base/error.h"

#include <iostream>
#include <string>

#include <fmt/format.h>

namespace gld {
TrainRefinerOptions::TrainRefinerOptions() {
  loop.optimiser.clip_norm = 1.0;
  loop.optimiser.ema_decay = 0.998;
  loop.learning_rate.schedule = LearningRateSchedule::kConstant;
  loop.learning_rate.peak = 2e-5;
}

void TrainRefinerOptions::visit(FieldVisitor& visitor) {
  StageOptions::visit(visitor);
  visitor.group({"objective", "losses"}, objective);
}

void TrainRefinerOptions::visit_data(FieldVisitor& visitor) {
  visitor.group({"data", "what to train on"}, data);
}

void TrainRefinerOptions::check() const {
  StageOptions::check();
  data.check();
  const bool decodes = objective.picture_weight > 0 || objective.perceptual.weight > 0;
  const int64_t undecoded = objective.denoising_steps + objective.latent_steps;
  // A network that only sees through noise is a beginning of its own.
  if (objective.latent_steps > 0 && decodes && undecoded >= loop.steps) {
    fail({"--objective.latent-steps",
          fmt::format("with --objective.denoising-steps {} fewer than the {} steps of the training, behind "
                      "which decoded pictures count",
                      objective.denoising_steps, loop.steps),
          std::to_string(objective.latent_steps),
          "lower it, or set --objective.picture-weight and --objective.perceptual.weight to 0"});
  }
}

std::string train_refiner(const TrainRefinerOptions& options, const DrawValidation& draw) {
  const BundleOptions model = ModelBundle::open(options.model).options();
  if (model.refiner.repairs_samples()) {
    fail({options.model + "/model.yaml", "a refiner of splats (degraded: splatted or colours)",
          "one of samples", "train it with gld train sample-refiner"});
  }
  if (!model.refiner.exists()) {
    fail({options.model + "/model.yaml", "a refiner", "none",
          "add for example refiner: {channels: [64, 96, 128], heads: [2, 3, 4]}"});
  }
  if (options.objective.perceptual.weight > 0 && options.objective.perceptual.lpips.lpips_backbone.empty())
    std::cerr << "note: " << standin_note() << ".\n";
  TrainingStage stage;
  stage.command = "train refiner";
  stage.made = {BundlePart::refiner()};
  stage.start = options.objective.start;
  stage.data = [&options](const ModelBundle& bundle) {
    const auto pairs = std::make_shared<SplatPairBatches>(options.data, bundle.options().refiner, bundle);
    StageData data;
    data.batches = pairs;
    data.validation = [pairs] { return pairs->validation(); };
    return data;
  };
  stage.objective = [&options](const ModelBundle& bundle, const ParameterPlacement& placement) {
    auto objective = std::make_unique<RefinerObjective>(
        bundle.options(), options.objective, bundle.load_backbone(placement),
        statistics_of_pictures(bundle, 0), placement, options.loop.seed);
    if (options.objective.start == ModelStart::kBundle) objective->start_from(bundle.load_refiner(placement));
    return objective;
  };
  return run_training_stage(options, options, TrainRefinerOptions(), stage, draw);
}

}  // namespace gld
