#include "models/cost/cost_model.h"

#include "models/bundle/bundle_options.h"
#include "models/layers/adaptive_norm.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

LatentGrid grid(int64_t views, int64_t height, int64_t width) {
  LatentGrid result;
  result.views = views;
  result.height = height;
  result.width = width;
  return result;
}

DitOptions published(int64_t decoder_blocks) {
  DitOptions options;
  options.depth = {28, decoder_blocks};
  return options;
}

// NUMBERS.md, "Cost of the published model", in TFLOP.
TEST(CostModel, AgreesWithThePublishedModelsCost) {
  EXPECT_NEAR(dit_cost(published(6), grid(8, 36, 36)).flop() / 1e12, 28.5, 0.3);
  EXPECT_NEAR(dit_cost(published(6), grid(8, 20, 36)).flop() / 1e12, 12.3, 0.15);
  const DitOptions cascade = published(2);
  EXPECT_NEAR(dit_cost(cascade, grid(8, 36, 36)).flop() / 1e12, 18.7, 0.2);
  EXPECT_NEAR(dit_cost(cascade, grid(8, 20, 36)).flop() / 1e12, 7.7, 0.15);
  const double encoder_share =
      condition_encoder_cost(cascade, grid(8, 36, 36)).flop() / dit_cost(cascade, grid(8, 36, 36)).flop();
  EXPECT_NEAR(encoder_share, 0.71, 0.01);
}

TEST(CostModel, AttentionIsHalfOfM1AtFullSize) {
  const Cost cost = dit_cost(published(6), grid(8, 36, 36));
  EXPECT_NEAR(cost.attention_flop / cost.flop(), 0.51, 0.01);
}

TEST(CostModel, WeightsAreThoseOfThePublishedModels) {
  // Numbers in the published checkpoints (checkpoint_manifests.json). Biases, norms, embedders of source features and
  // cameras are not counted by the model: 3 %.
  const double level1 = 0.7833e9, cascade = 0.4725e9;
  EXPECT_NEAR(static_cast<double>(dit_cost(published(6), grid(8, 36, 36)).weight_bytes) / 4 / level1, 1,
              0.03);
  EXPECT_NEAR(static_cast<double>(dit_cost(published(2), grid(8, 36, 36)).weight_bytes) / 4 / cascade, 1,
              0.03);
}

TEST(CostModel, GroupsOfViewsAreEqual) {
  EXPECT_EQ(views_per_group(8, 180), 8);  // 1440 tokens
  EXPECT_EQ(views_per_group(8, 360), 4);
  EXPECT_EQ(views_per_group(10, 360), 4);  // three groups, of 4, 4 and 2
  EXPECT_EQ(views_per_group(9, 500), 3);
  EXPECT_EQ(views_per_group(8, 1296), 1);
  EXPECT_EQ(views_per_group(8, 5000), 1);
  EXPECT_EQ(views_per_group(1, 0), 1);
  EXPECT_EQ(views_per_group(0, 64), 1);
}

TEST(CostModel, CostGrowsWithViewsAndDepth) {
  const BundleOptions bundle;
  const auto& backbone = bundle.backbone.architecture();
  const auto at = [&](int64_t views) { return backbone.encoding_cost(grid(views, 10, 18), 3); };
  // Linear layers grow with the tokens, attention over all views with their square.
  EXPECT_NEAR(at(8).linear_flop / at(4).linear_flop, 2, 1e-9);
  EXPECT_GT(at(8).attention_flop / at(4).attention_flop, 2.5);
  const Cost first = backbone.encoding_cost(grid(4, 10, 18), 1);
  const Cost rest = backbone.propagation_cost(grid(4, 10, 18), 1);
  EXPECT_NEAR(first.flop() + rest.flop(), at(4).flop(), 1e-6 * at(4).flop());
  EXPECT_GT(bundle.geometry_head.cost(grid(4, 10, 18), GeometryMaps::kDepthAndRays).flop(),
            bundle.geometry_head.cost(grid(4, 10, 18), GeometryMaps::kDepth).flop());
  const Cost drawing = rgb_decoder_cost(bundle.rgb_decoder, grid(4, 10, 18));
  EXPECT_GT(drawing.flop(), 0);
  EXPECT_EQ(drawing.convolution_flop, 0);
  RgbDecoderOptions refined = bundle.rgb_decoder;
  refined.refinement_channels = 16;
  refined.refinement_layers = 3;
  const Cost refining = rgb_decoder_cost(refined, grid(4, 10, 18));
  // A multiplication and an addition a weight and pixel.
  EXPECT_NEAR(refining.convolution_flop, 2.0 * (4 * 10 * 18 * 14 * 14) * 9 * (3 * 16 + 16 * 16 + 16 * 3), 1);
  EXPECT_GT(refining.working_bytes, drawing.working_bytes);
}

}  // namespace
}  // namespace gld
