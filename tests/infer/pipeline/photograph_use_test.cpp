#include "infer/pipeline/photograph_use.h"

#include "gld/photogrammetry/source_depth.h"
#include "tests/support/error_of.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

using Depth = PhotographOptions::DepthChoice;
using Compose = PhotographOptions::ComposeChoice;

PhotographModel published() { return {0, true, false}; }
PhotographModel shown_photographs() { return {2, true, false}; }
PhotographModel with_blending() { return {2, true, true}; }
PhotographModel with_refinement() {
  PhotographModel model = with_blending();
  model.has_depth_refinement = true;
  return model;
}

TEST(PhotographUse, WhatIsAutomaticTheModelDecides) {
  const PhotographOptions automatic;
  EXPECT_EQ(automatic.use(published()).depth, SourceDepthOrigin::kHead);
  EXPECT_FALSE(automatic.use(published()).composes());
  EXPECT_FALSE(automatic.use(published()).leaves_out_complete);
  EXPECT_EQ(automatic.use(shown_photographs()).depth, SourceDepthOrigin::kFused);
  EXPECT_EQ(automatic.use(shown_photographs()).composition, Composition::kPhotographs);
  EXPECT_EQ(automatic.use(with_blending()).composition, Composition::kBlended);
  EXPECT_TRUE(automatic.use(with_blending()).composes());
  EXPECT_TRUE(automatic.use(with_blending()).leaves_out_complete);
  EXPECT_EQ(automatic.use({0, true, true}).depth, SourceDepthOrigin::kFused);
  EXPECT_EQ(automatic.use(with_refinement()).depth, SourceDepthOrigin::kRefined);
  EXPECT_TRUE(automatic.use(with_refinement()).refines());
}

TEST(PhotographUse, DepthIsOffByAShareInTurns) {
  SourceDepth depth;
  depth.views = {{2, 1, {2, 0}}, {1, 1, {4}}, {1, 1, {3}}};
  const SourceDepth off = with_depth_error(depth, 0.25);
  EXPECT_EQ(off.views[0].values, (std::vector<float>{2.5F, 0}));
  EXPECT_EQ(off.views[1].values, std::vector<float>{3});
  EXPECT_EQ(off.views[2].values, std::vector<float>{3.75F});
  PhotographOptions options;
  options.depth_error = 0.25;
  EXPECT_EQ(options.use(with_blending()).depth_error, 0.25);
  EXPECT_EQ(PhotographOptions().use(with_blending()).depth_error, 0);
}

TEST(PhotographUse, OptionsComeBeforeTheModel) {
  PhotographOptions options;
  options.compose = Compose::kPhotographs;
  EXPECT_EQ(options.use(with_blending()).composition, Composition::kPhotographs);
  EXPECT_EQ(options.use(published()).composition, Composition::kPhotographs);
  options.compose = Compose::kNone;
  EXPECT_FALSE(options.use(with_blending()).composes());
  options.compose = Compose::kBlended;
  EXPECT_TRUE(options.use(with_blending()).blends());
  options.source_depth = Depth::kModel;
  options.generate_complete = true;
  EXPECT_EQ(options.use(with_blending()).depth, SourceDepthOrigin::kHead);
  EXPECT_FALSE(options.use(with_blending()).leaves_out_complete);
  options.source_depth = Depth::kFused;
  EXPECT_EQ(options.use(with_refinement()).depth, SourceDepthOrigin::kFused);
  options.source_depth = Depth::kRefined;
  EXPECT_TRUE(options.use(with_refinement()).refines());
}

TEST(PhotographUse, WithoutAHeadOnlyPhotographsSayHowDeepTheyAre) {
  PhotographOptions options;
  options.compose = Compose::kPhotographs;
  EXPECT_EQ(options.use({0, false, false}).depth, SourceDepthOrigin::kStereo);
}

TEST(PhotographUse, AModelWithoutTheNetworkCannotMendDepth) {
  PhotographOptions options;
  options.source_depth = Depth::kRefined;
  EXPECT_EQ(
      test::error_of([&] { options.use(with_blending()); }),
      "--source-depth: expected model, stereo or fused for a model without a depth_refinement part, found "
      "refined; choose one of them, or train the part with gld train depth.");
}

TEST(PhotographUse, AModelWithoutBlendingCannotBlend) {
  PhotographOptions options;
  options.compose = Compose::kBlended;
  EXPECT_EQ(
      test::error_of([&] { options.use(shown_photographs()); }),
      "--compose: expected photographs or none for a model without a blending part, found blended; choose one "
      "of them, or train the part with gld train blending.");
}

}  // namespace
}  // namespace gld
