#include "train/stages/sample_refiner_stage.h"

#include "gld/base/error.h"
#include "train/stages/latent_stages.h"

#include <memory>
#include <utility>

namespace gld {

void TrainSampleRefinerOptions::visit(FieldVisitor& visitor) {
  TrainOptions::visit(visitor);
  visitor.group({"objective", "what is repaired"}, objective);
}

void TrainSampleRefinerOptions::check() const {
  TrainOptions::check();
  objective.check();
}

std::string train_sample_refiner(const TrainSampleRefinerOptions& options, const DrawValidation& draw) {
  const BundleOptions model = ModelBundle::open(options.model).options();
  if (!model.refiner.repairs_samples()) {
    fail(
        {options.model + "/model.yaml", "a refiner of samples",
         model.refiner.exists() ? "one of splats" : "none",
         "add for example refiner: {degraded: generated, channels: [128, 192], heads: [4, 6], "
         "latent_channels: " +
             std::to_string(static_cast<int64_t>(model.generators.size()) * model.backbone.level_channels()) +
             ", attention: cross}"});
  }
  TrainingStage stage = scene_stage("train sample-refiner", options, FrameParts::kImage);
  stage.made = {BundlePart::refiner()};
  stage.start = options.objective.start;
  stage.objective = [&options](const ModelBundle& bundle, const ParameterPlacement& placement) {
    const BundleOptions& trained = bundle.options();
    FrozenGenerators generators;
    for (const GeneratorOptions& part : trained.generators) {
      generators.models.push_back(bundle.load_generator(part.generator, placement));
      generators.statistics.push_back(bundle.load_statistics(part.generator).to(placement.device));
    }
    auto objective = std::make_unique<SampleRefinerObjective>(
        trained, options.objective,
        frozen_parts_of_sampling(bundle, trained.level_set().warped_sources, placement,
                                 options.objective.carried_by),
        std::move(generators), placement, options.loop.seed);
    if (options.objective.start == ModelStart::kBundle) objective->start_from(bundle.load_refiner(placement));
    return objective;
  };
  return run_training_stage(options, options, TrainSampleRefinerOptions(), stage, draw);
}

}  // namespace gld
