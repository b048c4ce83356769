#include "gld/flow/schedule.h"
#include "models/bundle/bundle.h"
#include "models/bundle/random_bundle.h"
#include "models/dit/flow_matching_loss.h"
#include "models/latent_spaces/geometric_latent_space.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/objectives/level_objective.h"

#include <memory>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

// What `gld verify` replays and benchmarks time is what is trained: the same draw gives the same loss.
TEST(FlowObjective, TrainsTheFlowMatchingLoss) {
  const test::TemporaryFolder folder;
  write_random_bundle(folder.path(), test::small_model(), 7);
  const auto bundle = ModelBundle::open(folder.path());
  const auto model = bundle.load_generator(level_model(1));
  FlowObjectiveOptions options;
  options.camera_dropout = 0;
  FrozenParts frozen;
  frozen.space =
      std::make_shared<GeometricLatentSpace>(bundle.load_backbone(), bundle.options().boundary_level);
  frozen.statistics = bundle.load_statistics(level_model(1));
  LevelObjective objective(bundle.options(), 1, options, frozen, {}, 1);
  objective.start_from(*model);
  const DatasetBatches data(test::small_data(), test::small_model().image_sizes(), FrameParts::kImage);
  const auto batch = data.batch(0);
  StepContext context;
  context.generator = at::detail::createCPUGenerator(11);
  const auto losses = objective.losses(batch, context);

  const torch::NoGradGuard no_grad;
  const auto& scene = batch.scenes.front();
  const auto backbone = bundle.load_backbone();
  const auto statistics = bundle.load_statistics(level_model(1));
  const auto latent_of = [&](int64_t views) {
    const auto level = backbone->encode(scene.images.narrow(0, 0, views), 1)[1];
    return statistics.normalise(level.narrow(1, 1, level.size(1) - 1));
  };
  DitSceneInputs inputs;
  inputs.views = scene.views;
  inputs.source_features = latent_of(scene.views.num_sources);
  auto generator = at::detail::createCPUGenerator(11);
  FlowMatchingDraw draw;
  draw.clean = latent_of(scene.views.size());
  draw.time = shifted_time(torch::rand({2}, generator, torch::kFloat64)[0].item<double>(), 3.0);
  draw.noise = torch::randn(draw.clean.sizes(), generator, torch::kFloat32);
  const auto errors = flow_matching_errors(*model, inputs, draw);
  EXPECT_NEAR(losses.total.item<double>() / errors.all.item<double>(), 1, 1e-5);
  ASSERT_EQ(losses.parts.size(), 2U);
  EXPECT_NEAR(losses.parts[0].second.item<double>() / errors.source.item<double>(), 1, 1e-5);
  EXPECT_NEAR(losses.parts[1].second.item<double>() / errors.target.item<double>(), 1, 1e-5);
}

}  // namespace
}  // namespace gld
