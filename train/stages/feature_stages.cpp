#include "train/stages/feature_stages.h"

#include "gld/base/error.h"

#include <iostream>

#include <fmt/format.h>

namespace gld {

void TrainBackboneOptions::visit(FieldVisitor& visitor) {
  TrainOptions::visit(visitor);
  visitor.group({"objective", "losses"}, objective);
  visitor.group({"autoencoder", "losses of a backbone that decodes images itself, in the place of objective"},
                autoencoder);
}

TrainDecoderOptions::TrainDecoderOptions() {
  loop.optimiser.algorithm = OptimiserAlgorithm::kAdam;
  loop.optimiser.clip_norm = 0.0;
  loop.optimiser.ema_decay = 0.9978;
  loop.learning_rate.schedule = LearningRateSchedule::kCosine;
  loop.learning_rate.peak = 2e-4;
  loop.learning_rate.final = 2e-5;
  loop.learning_rate.warmup_steps = 1000;
}

void TrainDecoderOptions::visit(FieldVisitor& visitor) {
  TrainOptions::visit(visitor);
  visitor.group({"objective", "losses"}, objective);
}

TrainPhotographOptions::TrainPhotographOptions() {
  // One source alone leaves its depth without a unit: nothing is carried.
  data.views.fewest_sources = 2;
  loop.optimiser.clip_norm = 1.0;
  loop.optimiser.ema_decay = 0.998;
  loop.learning_rate.schedule = LearningRateSchedule::kLinear;
  loop.learning_rate.peak = 1.5e-3;
  loop.learning_rate.final = 1e-5;
  loop.learning_rate.warmup_steps = 100;
}

void TrainDepthOptions::visit(FieldVisitor& visitor) {
  TrainOptions::visit(visitor);
  visitor.group({"objective", "losses"}, objective);
}

void TrainBlendingOptions::visit(FieldVisitor& visitor) {
  TrainOptions::visit(visitor);
  visitor.group({"objective", "losses"}, objective);
}

std::string train_backbone(const TrainBackboneOptions& options, const DrawValidation& draw) {
  const BundleOptions model = ModelBundle::open(options.model).options();
  const bool head = model.geometry_head.exists(), autoencoder = !model.has_rgb_decoder();
  const bool with_depth =
      head || !options.objective.geometry_weights.empty() || options.objective.correspondence_weight > 0;
  TrainingStage stage =
      scene_stage("train backbone", options, with_depth ? FrameParts::kImageAndDepth : FrameParts::kImage);
  const bool head_only = options.objective.training == GeometryTraining::kHeadOnly;
  if (head_only && !head) {
    fail({"objective.training", "from_scratch or from_bundle for a model without a geometry head",
          "head_only", "choose one of them"});
  }
  if (head) stage.made.push_back(BundlePart::geometry_head());
  if (!head_only) stage.made.push_back(BundlePart::backbone());
  const bool goes_on = options.objective.training != GeometryTraining::kFromScratch;
  stage.start = goes_on ? ModelStart::kBundle : ModelStart::kRandom;
  stage.objective = [&options, goes_on, head, autoencoder](
                        const ModelBundle& bundle,
                        const ParameterPlacement& placement) -> std::unique_ptr<Objective> {
    TrainedGeometry trained;
    if (goes_on) trained.backbone = bundle.load_backbone(placement);
    if (autoencoder) {
      return std::make_unique<AutoencoderObjective>(bundle.options(), options.autoencoder, placement,
                                                    options.loop.seed, trained.backbone);
    }
    if (goes_on && head) trained.head = bundle.load_geometry_head(placement);
    return std::make_unique<BackboneObjective>(bundle.options(), options.objective, placement,
                                               options.loop.seed, trained);
  };
  return run_training_stage(options, options, TrainBackboneOptions(), stage, draw);
}

std::string train_decoder(const TrainDecoderOptions& options, const DrawValidation& draw) {
  TrainingStage stage = scene_stage("train decoder", options, FrameParts::kImage);
  if (!ModelBundle::open(options.model).options().has_rgb_decoder()) {
    fail({"train decoder", "a model with an RGB decoder", "one whose backbone decodes images itself",
          "train both halves with gld train backbone"});
  }
  for (const auto& note : stand_in_notes(options.objective)) std::cerr << "note: " << note << ".\n";
  stage.made = {BundlePart::rgb_decoder()};
  stage.start = options.objective.start;
  stage.objective = [&options](const ModelBundle& bundle, const ParameterPlacement& placement) {
    auto objective = std::make_unique<DecoderObjective>(
        bundle.options(), options.objective, bundle.load_backbone(placement), placement, options.loop.seed);
    if (options.objective.start == ModelStart::kBundle) {
      objective->start_from(bundle.load_rgb_decoder(placement));
    }
    return objective;
  };
  return run_training_stage(options, options, TrainDecoderOptions(), stage, draw);
}

namespace {

// What follows trains networks on the depth that photographs and geometry head tell.
void require_photograph_part(const TrainOptions& options, const PixelUnetOptions& network,
                             const std::string& part) {
  if (!network.exists()) {
    fail({options.model + "/model.yaml", "a " + part + " part", "none",
          "add for example " + part + ": {channels: [24, 32, 48, 64]}"});
  }
  if (options.data.views.fewest_sources < 2) {
    fail({"--fewest-sources", "at least 2, which tell the unit of depth",
          std::to_string(options.data.views.fewest_sources), "raise it"});
  }
  if (options.data.validation_sources == 1) {
    fail({"--validation-sources", "0 or at least 2, which tell the unit of depth", "1", "raise it"});
  }
}

void require_cpu(const ParameterPlacement& placement, const std::string& command) {
  if (placement.device.is_cpu()) return;
  fail({"--device", "cpu for " + command + ", which matches photographs there", placement.device.str(),
        "leave it out"});
}

}  // namespace

std::string train_depth(const TrainDepthOptions& options, const DrawValidation& draw) {
  const BundleOptions model = ModelBundle::open(options.model).options();
  require_photograph_part(options, model.depth_refinement, "depth_refinement");
  TrainingStage stage = scene_stage("train depth", options, FrameParts::kImageAndDepth);
  stage.made = {BundlePart::depth_refinement()};
  stage.start = options.objective.start;
  stage.objective = [&options](const ModelBundle& bundle, const ParameterPlacement& placement) {
    require_cpu(placement, "train depth");
    auto objective = std::make_unique<DepthRefinementObjective>(
        bundle.options(), options.objective, bundle.load_backbone(placement),
        bundle.load_geometry_head(placement), options.loop.seed);
    objective->keep_in(kept_scene_folder(
        options, bundle, {BundlePart::backbone(), BundlePart::geometry_head()}, placement.device,
        fmt::format("lessons of depth\nside {}", bundle.options().depth_refinement.side)));
    if (options.objective.start == ModelStart::kBundle) objective->start_from(bundle.load_depth_refinement());
    return objective;
  };
  return run_training_stage(options, options, TrainDepthOptions(), stage, draw);
}

std::string train_blending(const TrainBlendingOptions& options, const DrawValidation& draw) {
  const BundleOptions model = ModelBundle::open(options.model).options();
  require_photograph_part(options, model.blending, "blending");
  const bool with_depth = options.objective.true_depth > 0;
  TrainingStage stage =
      scene_stage("train blending", options, with_depth ? FrameParts::kImageAndDepth : FrameParts::kImage);
  stage.made = {BundlePart::blending()};
  stage.start = options.objective.start;
  stage.objective = [&options](const ModelBundle& bundle, const ParameterPlacement& placement) {
    require_cpu(placement, "train blending");
    BlendingDepthModels depth{bundle.load_backbone(placement), bundle.load_geometry_head(placement), nullptr};
    if (bundle.has(BundlePart::depth_refinement()))
      depth.refinement = bundle.load_depth_refinement(placement);
    auto objective =
        std::make_unique<BlendingObjective>(bundle.options(), options.objective, depth, options.loop.seed);
    objective->keep_in(kept_scene_folder(
        options, bundle,
        {BundlePart::backbone(), BundlePart::geometry_head(), BundlePart::depth_refinement()},
        placement.device, "candidates of blending"));
    if (options.objective.start == ModelStart::kBundle) objective->start_from(bundle.load_blending());
    return objective;
  };
  return run_training_stage(options, options, TrainBlendingOptions(), stage, draw);
}

}  // namespace gld
