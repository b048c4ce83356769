#include "gld/flow/schedule.h"
#include "gld/photogrammetry/pose_from_rays.h"
#include "models/bundle/bundle.h"
#include "models/bundle/random_bundle.h"
#include "models/conditioning/decoder_inputs.h"
#include "models/dit/flow_matching_loss.h"
#include "models/latent_spaces/latent_space.h"
#include "models/scene_geometry/source_warp.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/objectives/level_objective.h"
#include "train/objectives/source_view_depth.h"

#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

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
  frozen.space = std::make_shared<LatentSpace>(bundle.load_backbone(), bundle.options().boundary_level);
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

// This knows the depth and cameras of a scene's source views.
class TrueGeometry : public GeometryHead {
 public:
  explicit TrueGeometry(const TrainingScene& scene) {
    const int64_t sources = scene.views.num_sources;
    std::vector<torch::Tensor> rays;
    for (int64_t i = 0; i < sources; ++i) {
      const RayMap map = rays_of_camera(scene.views.cameras[static_cast<size_t>(i)], 16, 16);
      rays.push_back(torch::tensor(map.values).view({16, 16, 6}));
    }
    truth_.rays = torch::stack(rays);
    truth_.ray_confidence = torch::full({sources, 16, 16}, 2.0F);
    truth_.depth = scene.depth.narrow(0, 0, sources);
    truth_.depth_confidence = torch::full_like(truth_.depth, 2.0F);
  }
  GeometryOutput forward(const GeometryInputs& inputs, const LatentGrid& grid, GeometryMaps) const override {
    EXPECT_EQ(inputs.levels.size(), 4U);
    EXPECT_EQ(grid.views, truth_.depth.size(0));
    return truth_;
  }
  void initialise(const torch::Generator&) override {}

 private:
  GeometryOutput truth_;
};

std::map<std::string, double> validated(LevelObjective& objective, const std::vector<TrainingScene>& scenes) {
  const auto values = objective.validate(scenes).values;
  return {values.begin(), values.end()};
}

// Training shows a model what sampling will show it of the photographs that are carried into target views.
void check_what_is_shown(int64_t sources_of_scene) {
  const test::TemporaryFolder folder;
  BundleOptions small = test::small_model();
  small.generator(level_model(1)).dit.warped_sources = 2;
  small.single_source_unit = 1.25;
  write_random_bundle(folder.path(), small, 7);
  const auto bundle = ModelBundle::open(folder.path());
  const auto model = bundle.load_generator(level_model(1));
  auto data_options = test::small_data();
  data_options.views.fewest_sources = data_options.views.most_sources = sources_of_scene;
  const DatasetBatches data(data_options, small.image_sizes(), FrameParts::kImageAndDepth);
  const auto batch = data.batch(0);
  const auto& scene = batch.scenes.front();
  ASSERT_EQ(scene.views.num_sources, sources_of_scene);
  FrozenParts frozen;
  const auto space = std::make_shared<LatentSpace>(bundle.load_backbone(), bundle.options().boundary_level);
  frozen.space = space;
  frozen.statistics = bundle.load_statistics(level_model(1));
  frozen.geometry_head = std::make_shared<TrueGeometry>(scene);

  const torch::NoGradGuard no_grad;
  const auto sources = scene.images.narrow(0, 0, sources_of_scene);
  const auto encoded = space->encode(sources, 3);
  const auto geometry = frozen.geometry_head->forward(
      geometry_inputs(*space, encoded), space->grid_of(sources_of_scene, sources.size(2), sources.size(3)),
      GeometryMaps::kDepthAndRays);
  const auto normalised = [&](const torch::Tensor& level) {
    return frozen.statistics.normalise(level.slice(1, space->leading_tokens()));
  };
  const auto inputs_by = [&](const SourceDepth& depth) {
    const auto warp = warp_sources(scene.views, sources, depth, 2);
    EXPECT_EQ(warp.doubt, "");
    DitSceneInputs inputs;
    inputs.views = scene.views;
    inputs.source_features = normalised(encoded[1]);
    inputs.warp_agreement = warp.agreement;
    inputs.warped_features =
        normalised(space->encode(torch::cat({sources, warp.completed}), 1)[1].slice(0, sources.size(0)));
    return inputs;
  };
  const DitSceneInputs by_head =
      inputs_by(source_depth_of_head(scene.views, sources, geometry, small.single_source_unit));
  PhotographDepthOptions sampled;
  sampled.single_source_unit = small.single_source_unit;
  const DitSceneInputs by_photographs = inputs_by(
      photograph_depth(scene.views, sources, photographs_of_images(scene.views, sources), &geometry, sampled)
          .depth);
  EXPECT_FALSE(torch::equal(by_head.warped_features, by_photographs.warped_features));
  for (const bool dropped : {false, true}) {
    for (const auto& [carried_by, inputs, kept_gib] :
         {std::tuple(CarryingDepth::kHead, by_head, 0.0), std::tuple(CarryingDepth::kHead, by_head, 1.0),
          std::tuple(CarryingDepth::kPhotographs, by_photographs, 0.0)}) {
      FlowObjectiveOptions options;
      options.carried_by = carried_by;
      options.camera_dropout = dropped ? 1 : 0;
      options.kept_latents_gib = kept_gib;
      LevelObjective objective(bundle.options(), 1, options, frozen, {}, 1);
      objective.start_from(*model);
      auto generator = at::detail::createCPUGenerator(11);
      FlowMatchingDraw draw;
      draw.clean = normalised(space->encode(scene.images, 1)[1]);
      draw.time = shifted_time(torch::rand({2}, generator, torch::kFloat64)[0].item<double>(), 3.0);
      draw.noise = torch::randn(draw.clean.sizes(), generator, torch::kFloat32);
      draw.branch = dropped ? DitBranch::kUnconditional : DitBranch::kConditional;
      const double expected = flow_matching_errors(*model, inputs, draw).all.item<double>();
      for (int again = 0; again < 2; ++again) {
        StepContext context;
        context.generator = at::detail::createCPUGenerator(11);
        EXPECT_NEAR(objective.losses(batch, context).total.item<double>() / expected, 1,
                    kept_gib > 0 ? 1e-3 : 1e-5);
      }
      DitSceneInputs nothing = inputs;
      set_no_warp(nothing, model->options());
      const double without = flow_matching_errors(*model, nothing, draw).all.item<double>();
      options.carried_dropout = 1;
      LevelObjective uncarried(bundle.options(), 1, options, frozen, {}, 1);
      uncarried.start_from(*model);
      StepContext context;
      context.generator = at::detail::createCPUGenerator(11);
      EXPECT_NEAR(uncarried.losses(batch, context).total.item<double>() / without, 1,
                  kept_gib > 0 ? 1e-3 : 1e-5);
      if (dropped || kept_gib > 0) {
        EXPECT_EQ(validated(objective, batch.scenes).count("flow_loss_target_uncarried"), 0U);
      } else {
        FlowMatchingDraw held_out;
        held_out.clean = draw.clean;
        auto validation_draws = at::detail::createCPUGenerator(20240607);
        held_out.noise = torch::randn(draw.clean.sizes(), validation_draws, torch::kFloat32);
        double loss = 0;
        for (const double time : {0.125, 0.375, 0.625, 0.875}) {
          held_out.time = shifted_time(time, 3.0);
          loss += flow_matching_errors(*model, nothing, held_out).target.item<double>() / 4;
        }
        EXPECT_NEAR(validated(uncarried, batch.scenes).at("flow_loss_target_uncarried") / loss, 1, 1e-5);
      }
      if (dropped) {
        EXPECT_EQ(without, expected);  // the unconditional branch sees none of it
      } else {
        EXPECT_GT(std::abs(without / expected - 1), 1e-2);
      }
    }
  }
}

TEST(FlowObjective, ShowsThePhotographsInTheTargetViews) { check_what_is_shown(2); }

TEST(FlowObjective, ShowsASinglePhotographInTheUnitThatIsGuessed) { check_what_is_shown(1); }

}  // namespace
}  // namespace gld
