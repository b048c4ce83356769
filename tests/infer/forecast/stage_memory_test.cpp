#include "infer/forecast/stage_memory.h"

#include "gld/machine/block_memory.h"
#include "gld/tensors/torch_version.h"
#include "infer/forecast/dit_speed.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/forecast/stage_speed.h"
#include "models/backbones/da3_backbone.h"
#include "models/decoders/dpt_head.h"

#include <functional>
#include <string>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Large enough that activations, not the blocks under 64 KiB that are not counted, decide.
BundleOptions middling_bundle() {
  BundleOptions bundle;
  Da3BackboneOptions backbone;
  backbone.embed_dim = 128;
  backbone.num_heads = 4;
  bundle.backbone = backbone;
  auto& head = bundle.geometry_head.as<DptHeadOptions>();
  head.dim_in = 256;
  head.features = 64;
  head.out_channels = {24, 48, 96, 192};
  bundle.rgb_decoder.in_channels = 1024;
  bundle.rgb_decoder.hidden_size = 192;
  bundle.rgb_decoder.num_layers = 3;
  bundle.rgb_decoder.num_heads = 4;
  bundle.rgb_decoder.intermediate_size = 768;
  for (auto& part : bundle.generators) {
    part.dit.in_channels = 256;
    part.dit.hidden_size = {192, 288};
    part.dit.num_heads = {4, 6};
    part.dit.depth = {2, 1};
  }
  return bundle;
}

PlanRequest request_of(int64_t side) {
  PlanRequest request;
  request.grid.views = 4;
  request.grid.height = request.grid.width = side;
  request.num_sources = 2;
  request.outputs.image = request.outputs.points = true;
  request.flow.solvers.resize(2);
  for (auto& solver : request.flow.solvers) solver.evaluations = 1;
  request.flow.guidance.guidance_scale = 1;
  return request;
}

// Returns the most memory that tensors take while `work` runs, beyond what they take before.
int64_t tensor_bytes_of(const std::function<void()>& work) {
  release_kept_blocks();
  const int64_t before = used_block_bytes();
  work();
  return most_used_block_bytes() - before;
}

class StageMemoryPrediction : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    keep_freed_tensor_memory(int64_t{1} << 30);
    set_thread_count(1);  // every thread has scratch of its own
  }
};

TEST_F(StageMemoryPrediction, IsWhatTensorsOfEveryStageTake) {
  const BundleOptions bundle = middling_bundle();
  for (const int64_t side : {16, 28}) {
    const PlanRequest request = request_of(side);
    const SamplingPlan plan = plan_sampling(bundle, request);
    for (const PlannedStage& stage : plan.stages) {
      const bool flow = stage.kind == StageKind::kFlow;
      const int64_t taken = tensor_bytes_of([&] {
        if (flow) {
          MachineSpeed speed;
          speed.linear = speed.matrix_product = speed.attention = 1e11;
          measure_dit_speed(bundle.generators[stage.generator].dit, request, speed);
        } else {
          measure_stage_seconds(stage, bundle, request);
        }
      });
      const auto predicted = static_cast<double>(stage.memory.weights + stage.memory.working);
      EXPECT_NEAR(static_cast<double>(taken) / predicted, 1, 0.25) << stage.name << ", side " << side;
    }
  }
}

PlannedStage stage_of(const BundleOptions& bundle, const PlanRequest& request, StageKind kind) {
  for (const PlannedStage& stage : plan_sampling(bundle, request).stages) {
    if (stage.kind == kind) return stage;
  }
  ADD_FAILURE() << "no such stage";
  return {};
}

// Photographs are kept larger than the model sees them: of 2016x2016 three of them took 1.2 GB to lay together.
TEST_F(StageMemoryPrediction, CountsPhotographsAsTheyAreKept) {
  const BundleOptions bundle = middling_bundle();
  PlanRequest request = request_of(8);
  request.num_sources = 3;
  request.grid.views = 5;
  request.photographs_used.composition = Composition::kPhotographs;
  request.photographs_used.depth = SourceDepthOrigin::kFused;
  const int64_t small = stage_of(bundle, request, StageKind::kComposition).memory.held;
  const int64_t side = 8 * bundle.backbone.patch_side();
  request.photograph_magnification = 2016 / side;
  const auto pixels =
      static_cast<double>(side * side * request.photograph_magnification * request.photograph_magnification);
  const auto large =
      static_cast<double>(stage_of(bundle, request, StageKind::kComposition).memory.held - small);
  EXPECT_GT(large / pixels, 3 * 60);
  EXPECT_LT(large / pixels, 3 * 80 + 2 * 60);
  EXPECT_GT(stage_of(bundle, request, StageKind::kFlow).memory.held,
            static_cast<int64_t>(3 * 24 * 0.9 * pixels));
  // Neither matched nor kept, they are not loaded so large.
  request.photographs_used = {};
  EXPECT_LT(stage_of(bundle, request, StageKind::kFlow).memory.held, static_cast<int64_t>(pixels));
}

// It mends all source views at once, where the head has gone.
TEST_F(StageMemoryPrediction, MendingDepthTakesWhatIsSaid) {
  BundleOptions bundle = middling_bundle();
  bundle.depth_refinement.channels = {24, 32, 48};
  bundle.depth_refinement.side = 4096;
  PlanRequest request = request_of(16);
  request.photographs_used.composition = Composition::kPhotographs;
  request.photographs_used.depth = SourceDepthOrigin::kFused;
  const PlannedStage fused = stage_of(bundle, request, StageKind::kSourceDepth);
  request.photographs_used.depth = SourceDepthOrigin::kRefined;
  const PlannedStage refined = stage_of(bundle, request, StageKind::kSourceDepth);
  EXPECT_GT(refined.cost.flop(), fused.cost.flop());
  const int64_t taken = tensor_bytes_of([&] { measure_stage_seconds(refined, bundle, request); });
  const auto predicted = static_cast<double>(refined.memory.weights + refined.memory.working);
  EXPECT_NEAR(static_cast<double>(taken) / predicted, 1, 0.25);
}

TEST_F(StageMemoryPrediction, RefiningSamplesTakesWhatIsSaid) {
  BundleOptions bundle = middling_bundle();
  bundle.refiner.degraded = DegradedLatents::kGenerated;
  bundle.refiner.channels = {128, 192};
  bundle.refiner.heads = {4, 6};
  bundle.refiner.attention = ViewAttention::kCross;
  bundle.refiner.latent_channels =
      static_cast<int64_t>(bundle.generators.size()) * bundle.backbone.level_channels();
  for (const int64_t side : {16, 28}) {
    PlanRequest request = request_of(side);
    request.flow.refine = true;
    const PlannedStage stage = stage_of(bundle, request, StageKind::kSampleRefinement);
    const int64_t taken = tensor_bytes_of([&] { measure_stage_seconds(stage, bundle, request); });
    const auto predicted = static_cast<double>(stage.memory.weights + stage.memory.working);
    EXPECT_NEAR(static_cast<double>(taken) / predicted, 1, 0.25) << "side " << side;
  }
}

TEST_F(StageMemoryPrediction, APreviewKeepsWhatDrawsItBesideTheFlow) {
  const BundleOptions bundle = middling_bundle();
  PlanRequest request = request_of(16);
  const SamplingPlan without = plan_sampling(bundle, request);
  request.preview_every = 4;
  const SamplingPlan with = plan_sampling(bundle, request);
  const int64_t kept =
      weight_bytes_of(BundlePart::backbone(), bundle) + weight_bytes_of(BundlePart::rgb_decoder(), bundle);
  ASSERT_EQ(with.stages.size(), without.stages.size());
  for (size_t i = 0; i < with.stages.size(); ++i) {
    const StageMemory &more = with.stages[i].memory, &less = without.stages[i].memory;
    if (with.stages[i].kind != StageKind::kFlow) {
      EXPECT_EQ(with.stages[i].peak_bytes, without.stages[i].peak_bytes) << with.stages[i].name;
      continue;
    }
    EXPECT_EQ(more.weights, less.weights + kept) << with.stages[i].name;
    EXPECT_GT(more.held, less.held);
    EXPECT_GE(more.working, stage_of(bundle, request, StageKind::kRgbDecoding).memory.working);
    EXPECT_GT(with.stages[i].peak_bytes, without.stages[i].peak_bytes + kept / 2);
  }
}

TEST_F(StageMemoryPrediction, ConvertedWeightsAreThereBeforeTheyArePacked) {
  const BundleOptions bundle = middling_bundle();
  PlanRequest request = request_of(2);
  request.flow.precision = ComputePrecision::kInt8;
  const auto peak_of_m1 = [&] {
    for (const PlannedStage& stage : plan_sampling(bundle, request).stages) {
      if (stage.kind == StageKind::kFlow && stage.generator == 0) return stage.peak_bytes;
    }
    return int64_t{0};
  };
  const BundlePart m1 = BundlePart::of(bundle.generators[0].generator);
  const int64_t in_place = peak_of_m1();
  request.converted_bytes[bundle_part_name(m1)] = weight_bytes_of(m1, bundle);
  const int64_t converted = peak_of_m1();
  EXPECT_GT(in_place, 0);
  EXPECT_GT(converted, in_place);
  StageMemory alone;
  alone.converted = weight_bytes_of(m1, bundle);
  EXPECT_GE(converted, predicted_peak_bytes(alone));
}

TEST_F(StageMemoryPrediction, CountsAllWeights) {
  const BundleOptions bundle = middling_bundle();
  int64_t bytes = 0;
  for (const auto& parameter : DitDh(bundle.generators[0].dit, ParameterPlacement{}).parameters())
    bytes += 4 * parameter.numel();
  EXPECT_EQ(weight_bytes_of(BundlePart::of(level_model(1)), bundle), bytes);
}

}  // namespace
}  // namespace gld
