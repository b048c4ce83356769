// Samples that a refiner repairs behind the flows, by the pipeline and by its parts.
#include "infer/pipeline/sample_refinement.h"

#include "gld/cameras/cameras_in_a_row.h"
#include "gld/latents/latent_tokens.h"
#include "gld/latents/noise.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/method/sampling_method.h"
#include "infer/pipeline/bundle_models.h"
#include "models/bundle/random_bundle.h"
#include "models/refiner/denoising_unet.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cmath>

#include <torch/autograd.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr int64_t kRefinedViews = 4, kRefinedSources = 2, kRefinedSide = 28;

class SampleRefinement : public testing::TestWithParam<int64_t> {
 protected:
  SampleRefinement() {
    BundleOptions options = small_bundle_options();
    for (auto& part : options.generators) {
      part.dit.num_special_tokens = GetParam();
      if (GetParam() > 0) part.dit.hidden_size[1] = part.dit.in_channels;
    }
    options.refiner.degraded = DegradedLatents::kGenerated;
    options.refiner.channels = {8, 16};
    options.refiner.heads = {2, 2};
    options.refiner.norm_groups = 4;
    options.refiner.prompt_channels = 8;
    options.refiner.latent_channels = 2 * options.backbone.level_channels();
    options.refiner.references = 1;
    options.refiner.attention = ViewAttention::kCross;
    options.trained_sizes = {"28x28"};
    write_random_bundle(folder_.path() / "model", options, 7, DType::kFloat32);
  }
  ModelBundle bundle() const { return ModelBundle::open(folder_.path() / "model"); }
  PipelineRequest request(bool refine) const {
    const BundleOptions options = bundle().options();
    PipelineRequest request;
    request.views = cameras_in_a_row({kRefinedViews, kRefinedSources, {kRefinedSide, kRefinedSide}});
    torch::manual_seed(3);
    request.source_images = torch::rand({kRefinedSources, 3, kRefinedSide, kRefinedSide});
    for (const auto& part : options.generators) {
      request.noise.push_back(views_noise(5, level_noise_stream(part.generator.level), kRefinedViews,
                                          {part.dit.num_special_tokens + 4, part.dit.in_channels}));
    }
    SamplingMethod method;
    method.solver.evaluations = 2;
    method.refine = refine;
    request.flow = flow_settings(method, GuidanceOptions(), options);
    return request;
  }
  PipelineResult sampled(bool refine) const {
    StageRecords stages;
    return run_pipeline(bundle_models(bundle(), torch::kCPU), request(refine), stages);
  }
  test::TemporaryFolder folder_;
};
INSTANTIATE_TEST_SUITE_P(SpecialTokens, SampleRefinement, testing::Values(0, 1));

// A call of the network for each target view, of both levels' patch tokens as one map.
TEST_P(SampleRefinement, IsTheNetworksCallForEachTargetView) {
  const torch::NoGradGuard no_grad;
  const auto plain = sampled(false), refined = sampled(true);
  EXPECT_EQ(plain.refined, 0);
  EXPECT_EQ(refined.refined, kRefinedViews - kRefinedSources);
  const auto model = bundle();
  const auto raw = model.load_backbone()->encode(request(true).source_images, 1);
  std::vector<torch::Tensor> exact, made;
  for (const auto& part : model.options().generators) {
    const int64_t level = part.generator.level;
    const auto patches = model.load_statistics(part.generator).patches;
    const auto source = patches.normalise(raw[static_cast<size_t>(level)].slice(1, 1));
    exact.push_back(latents_of_tokens(source, {kRefinedSources, 2, 2}, 1));
    made.push_back(latents_of_tokens(plain.latents.at(level).slice(1, GetParam()), {kRefinedViews, 2, 2}, 1));
  }
  const auto references = torch::cat(exact, 1), degraded = torch::cat(made, 1);
  const auto unet = model.load_refiner();
  for (int64_t view = kRefinedSources; view < kRefinedViews; ++view) {
    // Cameras stand in a row: the last source is the nearest.
    const auto seen = torch::stack({degraded[view], references[1]}).unsqueeze(0);
    const auto repaired = refined_latents(*unet, seen)[0];
    int64_t channel = 0;
    for (const auto& part : model.options().generators) {
      const auto& latent = refined.latents.at(part.generator.level);
      const int64_t channels = latent.size(2);
      const auto wanted = repaired.slice(0, channel, channel + channels).flatten(1).t();
      EXPECT_LT((latent[view].slice(0, GetParam()) - wanted).abs().max().item<double>(), 1e-5);
      EXPECT_GT((plain.latents.at(part.generator.level)[view].slice(0, GetParam()) - wanted)
                    .abs()
                    .max()
                    .item<double>(),
                1e-3);
      channel += channels;
    }
  }
  EXPECT_GT((plain.images - refined.images).abs().max().item<double>(), 1e-4);
}

// bench sample counts such a sample as not finite, and goes on.
TEST_P(SampleRefinement, NamesItsStageWhereANumberIsNotFinite) {
  auto broken = bundle().load_refiner();
  for (auto& parameter : broken->named_parameters()) parameter.value().data().fill_(std::nan(""));
  PipelineModels models = bundle_models(bundle(), torch::kCPU);
  models.refiner = [&broken] { return broken; };
  StageRecords stages;
  EXPECT_EQ(
      test::error_of([&] { run_pipeline(models, request(true), stages); }),
      "sample refinement: expected finite numbers, found NaN or infinity in the repaired latents; check the "
      "refiner with gld inspect.");
}

TEST_P(SampleRefinement, LeavesSourceViewsAndSpecialTokensAsTheyAre) {
  const auto plain = sampled(false), refined = sampled(true);
  for (const int64_t level : {0, 1}) {
    const auto& before = plain.latents.at(level);
    const auto& after = refined.latents.at(level);
    EXPECT_TRUE(torch::equal(before.slice(0, 0, kRefinedSources), after.slice(0, 0, kRefinedSources)))
        << level;
    if (GetParam() == 0) continue;
    EXPECT_TRUE(torch::equal(before.slice(1, 0, GetParam()), after.slice(1, 0, GetParam()))) << level;
  }
}

TEST_P(SampleRefinement, IsPlannedWithItsWeightsAndItsOperations) {
  PlanRequest plan;
  plan.grid = {kRefinedViews, 2, 2};
  plan.num_sources = kRefinedSources;
  plan.outputs.image = true;
  plan.flow = request(true).flow;
  const BundleOptions options = bundle().options();
  const auto stages = plan_sampling(options, plan).stages;
  const auto found = std::find_if(stages.begin(), stages.end(), [](const PlannedStage& stage) {
    return stage.kind == StageKind::kSampleRefinement;
  });
  ASSERT_NE(found, stages.end());
  EXPECT_DOUBLE_EQ(found->cost.flop(), 2 * refiner_cost(options.refiner, 2, 2, 2).flop());
  EXPECT_GT(found->memory.weights, 0);
  const auto parts = needed_parts(options, plan.stage_request());
  EXPECT_THAT(parts, testing::Contains(BundlePart::refiner()));
  plan.flow.refine = false;
  EXPECT_THAT(needed_parts(options, plan.stage_request()),
              testing::Not(testing::Contains(BundlePart::refiner())));
}

TEST(SampleRefinementOfAModel, ThatHasNoneIsRefused) {
  SamplingMethod method;
  method.refine = true;
  EXPECT_EQ(test::error_of([&] { flow_settings(method, GuidanceOptions(), small_bundle_options()); }),
            "--refine: expected a model with a refiner of samples, found none in " +
                small_bundle_options().name +
                "; train one with gld train sample-refiner, or leave --refine out.");
}

TEST(SampleRefinementOfAModel, HasTheChannelsOfAllGeneratedLevels) {
  BundleOptions options = small_bundle_options();
  options.refiner.channels = {32, 32};
  options.refiner.heads = {2, 2};
  EXPECT_THAT(test::error_of([&] { options.check(); }),
              testing::HasSubstr("refiner.degraded: expected generated for a model with an RGB decoder"));
  options.refiner.degraded = DegradedLatents::kGenerated;
  EXPECT_THAT(test::error_of([&] { options.check(); }),
              testing::AllOf(testing::HasSubstr("refiner.latent_channels"),
                             testing::HasSubstr("the channels of all generated levels together")));
}

}  // namespace
}  // namespace gld
