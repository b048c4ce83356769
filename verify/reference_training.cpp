#include "train/objectives/diffusion_replay.h"
#include "verify/reference_dit.h"
#include "verify/reference_runners.h"

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
  reference.compute.precision = ComputePrecision::kFloat32;  // what the case was made in, and held to
  TrainingCaseOptions options;
  reference.read_config(options);
  const auto model = reference_dit(reference, options.model);
  DiffusionReplayScene scene;
  scene.inputs = reference_scene(reference, options);
  scene.clean = reference_latent(reference, "clean", options);
  scene.noise = reference_latent(reference, "noise", options);
  return replay_diffusion_training(*model, scene, options.replay);
}

}  // namespace gld
