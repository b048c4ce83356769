#include "infer/forecast/stage_speed.h"

#include "infer/forecast/sampling_plan.h"
#include "models/bundle/random_bundle.h"

#include <algorithm>
#include <memory>

#include <gtest/gtest.h>

namespace gld {
namespace {

// --geometry-model beside a model that has no head of its own.
TEST(StageSpeed, GeometryIsMeasuredOnTheModelThatItComesFrom) {
  BundleOptions bundle = small_bundle_options();
  bundle.geometry_head = GeometryHeadOptions::none();
  PlanRequest request;
  request.grid = bundle.backbone.grid_of(2, 56, 56);
  request.num_sources = 1;
  request.outputs.depth = true;
  request.flow.solvers.resize(bundle.generators.size());
  request.geometry_model = std::make_shared<const BundleOptions>(small_bundle_options());
  const auto plan = plan_sampling(bundle, request);
  const auto geometry = std::find_if(plan.stages.begin(), plan.stages.end(), [](const PlannedStage& stage) {
    return stage.kind == StageKind::kGeometry;
  });
  ASSERT_NE(geometry, plan.stages.end());
  ASSERT_TRUE(geometry->runs);
  EXPECT_GT(measure_stage_seconds(*geometry, bundle, request), 0);
}

TEST(StageSpeed, EveryStageIsMeasuredWhereverPropagationStarts) {
  for (const int64_t boundary : {0, 1, 2, 3}) {
    BundleOptions bundle = small_bundle_options();
    bundle.boundary_level = boundary;
    bundle.set_generators({level_model(boundary)});
    bundle.decoded_levels.clear();
    for (int64_t level = boundary; level < 4; ++level) bundle.decoded_levels.push_back(level);
    bundle.rgb_decoder.in_channels = (4 - boundary) * bundle.backbone.level_channels();
    bundle.geometry_head = GeometryHeadOptions::none();
    for (auto& part : bundle.generators) {
      part.dit.in_channels = bundle.backbone.level_channels();
      part.dit.hidden_size = {32, 32};
      part.dit.depth = {1, 1};
      part.dit.num_heads = {2, 2};
    }
    PlanRequest request;
    request.grid = bundle.backbone.grid_of(3, 56, 56);
    request.num_sources = 2;
    request.outputs.image = true;
    request.flow.solvers.resize(bundle.generators.size());
    for (const auto& stage : plan_sampling(bundle, request).stages) {
      const bool once = stage.runs && stage.kind != StageKind::kFlow && stage.cost.flop() > 0;
      if (!once) continue;
      EXPECT_GT(measure_stage_seconds(stage, bundle, request), 0) << boundary << ' ' << stage.name;
    }
  }
}

}  // namespace
}  // namespace gld
