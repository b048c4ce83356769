#include "cli/reference_training.h"

#include "infer/verify/reference_dit.h"
#include "infer/verify/reference_runners.h"
#include "train/objectives/diffusion_replay.h"

namespace gld {
namespace {

struct TrainingCaseOptions : DitCaseOptions {
  DiffusionReplayOptions replay;

  void visit(FieldVisitor& visitor) override {
    DitCaseOptions::visit(visitor);
    replay.visit(visitor);
  }
  void check() const override {
    DitCaseOptions::check();
    replay.check();
  }
};

}  // namespace

NamedTensors run_train_diffusion_case(const ReferenceCase& given) {
  ReferenceCase reference = given;
  reference.precision = ComputePrecision::kFloat32;  // what the case was made in, and held to
  TrainingCaseOptions options;
  reference.read_config(options);
  const auto model = reference_dit(reference, options.model);
  DiffusionReplayScene scene;
  scene.inputs = reference_scene(reference, options);
  scene.clean = reference_latent(reference, "clean", options);
  scene.noise = reference_latent(reference, "noise", options);
  return replay_diffusion_training(*model, scene, options.replay);
}

ReferenceRunners all_reference_runners() {
  auto runners = standard_reference_runners();
  runners["train_diffusion"] = run_train_diffusion_case;
  return runners;
}

}  // namespace gld
