// Bundles with other sets of generated levels than the published one, sampled by the pipeline and by running the parts
// one after another here.

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/cameras/cameras_in_a_row.h"
#include "gld/flow/flow.h"
#include "gld/flow/schedule.h"
#include "gld/latents/noise.h"
#include "infer/method/sampling_method.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/pipeline/sampling_stages.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr int64_t kSetHeight = 28, kSetWidth = 42;  // pixels
constexpr int64_t kViews = 3, kSources = 2;

struct SetCase {
  const char* name;
  std::vector<LevelGenerator> generators;
  int64_t boundary = 1;
  std::vector<int64_t> decoded;
  int64_t special_tokens = 0;
};

BundleOptions options_of(const SetCase& set) {
  BundleOptions options = small_bundle_options();
  const DitOptions like = options.generators.front().dit;
  options.set_generators(set.generators);
  for (auto& part : options.generators) {
    const auto conditioning = part.dit.conditioning;
    part.dit = like;
    part.dit.conditioning = conditioning;
    part.dit.num_special_tokens = set.special_tokens;
    if (set.special_tokens > 0) part.dit.hidden_size[1] = part.dit.in_channels;
  }
  options.boundary_level = set.boundary;
  options.decoded_levels = set.decoded;
  if (!set.decoded.empty()) {
    options.rgb_decoder.in_channels =
        static_cast<int64_t>(set.decoded.size()) * options.backbone.level_channels();
  }
  options.trained_sizes = {"42x28"};
  return options;
}

PipelineRequest request_of(const BundleOptions& options) {
  PipelineRequest request;
  request.views = cameras_in_a_row({kViews, kSources, {kSetWidth, kSetHeight}});
  torch::manual_seed(3);
  request.source_images = torch::rand({kSources, 3, kSetHeight, kSetWidth});
  const int64_t tokens = (kSetHeight / 14) * (kSetWidth / 14);
  for (const auto& part : options.generators) {
    request.noise.push_back(views_noise(5, level_noise_stream(part.generator.level), kViews,
                                        {part.dit.num_special_tokens + tokens, part.dit.in_channels}));
    SolverOptions solver;
    solver.solver = SolverKind::kEuler;
    solver.evaluations = 2;
    solver.schedule.schedule = ScheduleKind::kUniform;
    request.flow.solvers.push_back(solver);
  }
  request.flow.guidance.guidance_scale = 1;
  return request;
}

// Euler with two steps, without anything of the pipeline.
torch::Tensor flow_by_hand(const DitDh& model, const DitSceneInputs& inputs, torch::Tensor state) {
  const auto scene = model.prepare_scene(inputs);
  for (const double t : {1.0, 0.5}) {
    state = state - 0.5 * model.velocity(scene, state, model.time_rows({t}).front());
  }
  return state;
}

LatentStatistics read(const ModelBundle& bundle, const std::string& name) {
  return read_latent_statistics(bundle.folder() / (name + ".safetensors"), bundle.options().latent_epsilon);
}

class LevelSets : public testing::TestWithParam<SetCase> {};

TEST_P(LevelSets, ThePipelineIsThePartsOneAfterAnother) {
  const torch::NoGradGuard no_grad;
  const SetCase& set = GetParam();
  const auto options = options_of(set);
  const test::TemporaryFolder folder;
  write_random_bundle(folder.path() / "model", options, 7, DType::kFloat32);
  const auto bundle = ModelBundle::open(folder.path() / "model");
  const auto request = request_of(options);
  StageRecords stages;
  const auto made = run_pipeline(bundle_models(bundle, torch::kCPU), request, stages);

  const auto backbone = bundle.load_backbone();
  const auto raw = backbone->encode(request.source_images, 3);
  const int64_t special = set.special_tokens;
  DitSceneInputs scene;
  scene.views = request.views;
  std::map<int64_t, torch::Tensor> latents, features;
  for (size_t i = 0; i < options.generators.size(); ++i) {
    const auto generator = options.generators[i].generator;
    const auto level = std::to_string(generator.level);
    const auto patches = read(bundle, "statistics_level" + level);
    const auto normalise = [&](const torch::Tensor& tokens) {
      auto tail = patches.normalise(tokens.slice(1, 1));
      if (special == 0) return tail;
      return torch::cat(
          {read(bundle, "special_statistics_level" + level).normalise(tokens.slice(1, 0, 1)), tail}, 1);
    };
    scene.source_features = normalise(raw[static_cast<size_t>(generator.level)]);
    scene.deeper_level = generator.deeper ? latents.at(*generator.deeper) : torch::Tensor();
    latents[generator.level] = flow_by_hand(*bundle.load_generator(generator), scene, request.noise[i]);
    const auto latent = latents[generator.level];
    features[generator.level] = patches.denormalise(latent.slice(1, special));
    if (special > 0 && generator.level == set.boundary) {
      features[-1] =
          read(bundle, "special_statistics_level" + level).denormalise(latent.slice(1, 0, special));
    }
  }
  for (const auto& [level, latent] : latents) {
    EXPECT_LT((made.latents.at(level) - latent).abs().max().item<double>(), 1e-5) << "level " << level;
  }
  auto leading = special > 0 ? features.at(-1)
                             : backbone->encode(request.source_images.slice(0, 0, 1), set.boundary)
                                   .at(static_cast<size_t>(set.boundary))
                                   .slice(1, 0, 1)
                                   .expand({kViews, 1, options.backbone.level_channels()});
  PropagationStart start;
  start.level = set.boundary;
  start.tokens = torch::cat({leading, features.at(set.boundary)}, 1);
  start.grid = made.grid;
  std::map<int64_t, torch::Tensor> levels;
  int64_t level = set.boundary;
  for (const auto& propagated : backbone->propagate(start)) levels[level++] = propagated.patches;
  for (const auto& [shallow, tokens] : features) {
    if (shallow >= 0 && shallow < set.boundary) levels[shallow] = backbone->normalise_for_decoding(tokens);
  }
  std::vector<torch::Tensor> decoded;
  for (const int64_t wanted : options.level_set().decoded_levels()) {
    decoded.push_back(levels.at(wanted).slice(0, kSources).contiguous());
  }
  LatentGrid targets = made.grid;
  targets.views = kViews - kSources;
  const auto images = bundle.load_rgb_decoder()->decode(torch::cat(decoded, 2), targets);
  EXPECT_LT((made.images - images).abs().max().item<double>(), 1e-4);
}

TEST(TimeShiftOfTheLatent, IsTakenWhereNoneIsGiven) {
  const auto options = options_of({"published", {level_model(1), cascade(1, 0)}, 1, {}, 0});
  const test::TemporaryFolder folder;
  write_random_bundle(folder.path() / "model", options, 7, DType::kFloat32);
  const auto models = bundle_models(ModelBundle::open(folder.path() / "model"), torch::kCPU);
  auto request = request_of(options);
  const double shift =
      time_shift_of({kViews, kSetHeight / 14, kSetWidth / 14}, options.backbone.level_channels());
  EXPECT_GT(std::abs(shift - 1), 0.1);
  StageRecords stages;
  for (auto& solver : request.flow.solvers) {
    solver.schedule.schedule = ScheduleKind::kShifted;
    solver.schedule.shift = 0;
  }
  const auto by_rule = run_pipeline(models, request, stages);
  for (auto& solver : request.flow.solvers) solver.schedule.shift = shift;
  const auto given = run_pipeline(models, request, stages);
  ASSERT_EQ(by_rule.flows.size(), 2U);
  for (size_t i = 0; i < by_rule.flows.size(); ++i) {
    EXPECT_EQ(by_rule.flows[i].times, given.flows[i].times);
    EXPECT_NEAR(by_rule.flows[i].times.at(1), shifted_time(0.5, shift), 1e-12);
  }
}

// After the first of two Euler steps the prediction is what one step alone ends with.
TEST(Preview, IsWhatTheFlowWouldEndWithNow) {
  const auto options = options_of({"published", {level_model(1), cascade(1, 0)}, 1, {}, 0});
  const test::TemporaryFolder folder;
  write_random_bundle(folder.path() / "model", options, 7, DType::kFloat32);
  const auto models = bundle_models(ModelBundle::open(folder.path() / "model"), torch::kCPU);
  auto request = request_of(options);
  std::vector<std::string> stages_shown;
  torch::Tensor shown;
  request.preview_every = 1;
  request.on_preview = [&](const std::string& stage, const torch::Tensor& images) {
    stages_shown.push_back(stage);
    shown = images;
  };
  StageRecords stages;
  const auto whole = run_pipeline(models, request, stages);
  ASSERT_EQ(stages_shown.size(), 2U) << "the end of a flow is no preview";
  EXPECT_NE(stages_shown.front(), stages_shown.back());
  request.on_preview = nullptr;
  EXPECT_TRUE(torch::equal(run_pipeline(models, request, stages).images, whole.images));
  request.flow.solvers[1].evaluations = 1;
  const auto one_step = run_pipeline(models, request, stages);
  EXPECT_LT((shown - one_step.images).abs().max().item<double>(), 1e-5);
  EXPECT_GT((shown - whole.images).abs().max().item<double>(), 1e-3);
}

TEST(Pipeline, StopsBetweenStepsWhereItsCallerWishes) {
  const auto options = options_of({"boundary_0", {level_model(0)}, 0, {}, 0});
  const test::TemporaryFolder folder;
  write_random_bundle(folder.path() / "model", options, 7, DType::kFloat32);
  auto request = request_of(options);
  request.flow.solvers[0].evaluations = 6;
  int64_t steps = 0;
  request.on_step = [&](const std::string&, const SolveProgress& progress) { steps = progress.step; };
  request.stop_requested = [&] { return steps == 2; };
  StageRecords stages;
  EXPECT_THROW(
      run_pipeline(bundle_models(ModelBundle::open(folder.path() / "model"), torch::kCPU), request, stages),
      Interrupted);
  EXPECT_EQ(steps, 2);
}

INSTANTIATE_TEST_SUITE_P(
    All, LevelSets,
    testing::Values(
        SetCase{"published", {level_model(1), cascade(1, 0)}, 1, {}, 0},
        SetCase{"boundary_0", {level_model(0)}, 0, {}, 0},
        SetCase{"independent_levels", {level_model(0), level_model(1)}, 1, {}, 0},
        SetCase{"boundary_2", {level_model(2), cascade(2, 1), cascade(1, 0)}, 2, {}, 0},
        SetCase{"boundary_3", {level_model(3), level_model(2), level_model(1), level_model(0)}, 3, {}, 0},
        SetCase{"one_level", {level_model(3)}, 3, {3}, 0},
        SetCase{"special_tokens", {level_model(1), cascade(1, 0)}, 1, {}, 1},
        SetCase{"special_tokens_boundary_2", {level_model(2), level_model(1), level_model(0)}, 2, {}, 1}),
    [](const testing::TestParamInfo<SetCase>& info) { return std::string(info.param.name); });

TEST(LevelSetBundle, AModelOfTodayReadsAsThePublishedSetAndAnotherBoundaryIsRefused) {
  BundleOptions options;
  load_yaml_text(options, "boundary_level: 1\n", "model.yaml");
  ASSERT_EQ(options.generators.size(), 2U);
  EXPECT_EQ(options.generators[0].generator, level_model(1));
  EXPECT_EQ(options.generators[1].generator, cascade(1, 0));
  load_yaml_text(options, "boundary_level: 2\n", "model.yaml");
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "generated: expected a part that generates boundary_level 2, which propagation starts from, "
            "found none in generated; add 2 to generated or change boundary_level.");
}

TEST(LevelSetBundle, OptionsOfOtherSetsAreWrittenAndRead) {
  const auto options = options_of({"", {level_model(2), cascade(2, 1), level_model(0)}, 2, {0, 2}, 0});
  BundleOptions read;
  load_yaml_text(read, to_yaml(options), "model.yaml");
  EXPECT_EQ(to_yaml(read), to_yaml(options));
  EXPECT_THAT(to_yaml(options), testing::HasSubstr("cascade_2_to_1:"));
}

TEST(LevelSetBundle, GeometryOfAModelThatLeavesLevelsOutIsRefused) {
  const auto options = options_of({"", {level_model(3)}, 3, {3}, 0});
  EXPECT_FALSE(options.has_geometry());
  const test::TemporaryFolder folder;
  write_random_bundle(folder.path() / "model", options, 7, DType::kFloat32);
  auto request = request_of(options);
  request.geometry_views = DecodedViews::kTargets;
  StageRecords stages;
  EXPECT_EQ(test::error_of([&] {
              run_pipeline(bundle_models(ModelBundle::open(folder.path() / "model"), torch::kCPU), request,
                           stages);
            }),
            "geometry: expected all levels, which the DPT head takes, found no level 0; ask for images "
            "alone, or use a model that generates it.");
}

// The depth of the source views is asked for where something is done with it, and by one stage.
TEST(SamplingStages, PhotographsAreCarriedForModelsThatTakeThem) {
  LevelSet levels;
  levels.generators = {level_model(1), cascade(1, 0)};
  StageRequest request;
  request.views = 4;
  request.num_sources = 2;
  const auto has_warp = [&] {
    const auto stages = sampling_stages(levels, request);
    return std::any_of(stages.begin(), stages.end(),
                       [](const SamplingStage& stage) { return stage.kind == StageKind::kSourceWarp; });
  };
  EXPECT_FALSE(has_warp());
  EXPECT_FALSE(uses_source_depth(levels, request));
  EXPECT_EQ(deepest_encoded_level(levels, request), 1);
  levels.warped_sources = 2;
  EXPECT_TRUE(has_warp());
  EXPECT_TRUE(uses_source_depth(levels, request));
  EXPECT_EQ(deepest_encoded_level(levels, request), 3);
  // One source has no scale: the stage is listed with that reason, and no depth is asked for.
  request.num_sources = 1;
  EXPECT_TRUE(has_warp());
  EXPECT_FALSE(uses_source_depth(levels, request));
  EXPECT_FALSE(needs_source_depth(levels, request));
  // Unless whoever found its camera says how deep it is, in the camera's unit.
  request.source_depth_given = true;
  EXPECT_TRUE(needs_source_depth(levels, request));
  EXPECT_FALSE(uses_source_depth(levels, request));
  // Or the head does, in the unit that is usual for the model; not photographs alone.
  request.source_depth_given = false;
  request.single_source_unit_known = true;
  EXPECT_TRUE(uses_source_depth(levels, request));
  request.photographs.depth = SourceDepthOrigin::kStereo;
  EXPECT_FALSE(needs_source_depth(levels, request));
}

// Records are found again under the names that stages have.
TEST(SamplingStages, AreTimedByTheirKind) {
  LevelSet levels;
  levels.generators = {level_model(1), cascade(1, 0)};
  levels.warped_sources = 2;
  StageRequest request;
  request.views = 4;
  request.num_sources = 2;
  request.geometry_views = DecodedViews::kAll;
  const auto stages = sampling_stages(levels, request);
  ASSERT_EQ(stages.size(), 7U);
  StageRecords records;
  for (const SamplingStage& stage : stages) records.run(stage.name, [] {});
  records.run("writing", [] {});
  const auto seconds = [&](size_t number) { return records.records()[number].seconds; };
  EXPECT_EQ(stages[0].kind, StageKind::kSourceEncoding);
  EXPECT_EQ(stage_seconds(levels, StageKind::kSourceEncoding, records), seconds(0));
  EXPECT_EQ(stage_seconds(levels, StageKind::kSourceWarp, records), seconds(1));
  EXPECT_EQ(stage_seconds(levels, StageKind::kFlow, records), seconds(2) + seconds(3));
  EXPECT_EQ(stage_seconds(levels, StageKind::kPropagation, records), seconds(4));
  EXPECT_EQ(stage_seconds(levels, StageKind::kRgbDecoding, records), seconds(5));
  EXPECT_EQ(stage_seconds(levels, StageKind::kGeometry, records), seconds(6));
}

TEST(SamplingStages, WhatFlowsAreShownIsFloat32InEveryPrecision) {
  for (const auto asked : {ComputePrecision::kBFloat16, ComputePrecision::kInt8}) {
    SCOPED_TRACE(compute_precision_name(asked));
    for (const auto kind : {StageKind::kSourceEncoding, StageKind::kPropagation, StageKind::kSourceWarp,
                            StageKind::kGeometry}) {
      const LayerPrecision layers = layer_precision(asked, model_kind_of(kind));
      EXPECT_EQ(layers.linear, ComputePrecision::kFloat32);
      EXPECT_EQ(layers.attention, ComputePrecision::kFloat32);
    }
    EXPECT_EQ(layer_precision(asked, model_kind_of(StageKind::kFlow)).linear, asked);
  }
}

}  // namespace
}  // namespace gld
