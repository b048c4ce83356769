#include "models/backbones/da3_backbone.h"

#include "gld/base/configuration.h"
#include "models/weights/weight_loading.h"
#include "tests/models/backbones/small_da3.h"
#include "tests/support/error_of.h"
#include "tests/support/largest_difference.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::largest_difference;
using test::random_da3;
using test::small_da3;

torch::Tensor random_images(int64_t views, int64_t height, int64_t width, uint64_t seed = 2) {
  return torch::randn({views, 3, height, width}, at::detail::createCPUGenerator(seed));
}

// Returns what cubic convolution with PyTorch's coefficient -0.75 makes of the sequence 0, 1, 2, ... at position x.
double interpolated_index(double x) {
  constexpr double kA = -0.75;
  const double first = std::floor(x), t = x - first;
  const auto near = [](double d) { return ((kA + 2) * d - (kA + 3)) * d * d + 1; };
  const auto far = [](double d) { return ((d - 5) * d + 8) * d * kA - 4 * kA; };
  return (first - 1) * far(t + 1) + first * near(t) + (first + 1) * near(1 - t) + (first + 2) * far(2 - t);
}

TEST(Da3Backbone, GiantHasFusedSwigluAndAlternatesFromItsOddStart) {
  Da3BackboneOptions options;
  load_json(options,
            {{"embed_dim", 1536},
             {"depth", 40},
             {"num_heads", 24},
             {"ffn_layer", "swiglufused"},
             {"out_layers", {19, 27, 33, 39}},
             {"alternating_start", 13},
             {"qk_norm_start", 13},
             {"rope_start", 13}},
            "test");
  ParameterPlacement nowhere;
  nowhere.device = torch::kMeta;
  const auto tensors = named_tensors(Da3Backbone(options, nowhere));
  EXPECT_EQ(tensors.at("blocks.0.mlp.w12.weight").sizes(), (std::vector<int64_t>{8192, 1536}));
  EXPECT_EQ(tensors.at("blocks.39.mlp.w3.weight").sizes(), (std::vector<int64_t>{1536, 4096}));
  EXPECT_EQ(tensors.at("blocks.13.attn.q_norm.weight").sizes(), (std::vector<int64_t>{64}));
  EXPECT_EQ(tensors.count("blocks.12.attn.q_norm.weight"), 0u);
  EXPECT_EQ(tensors.count("blocks.0.mlp.fc1.weight"), 0u);
}

TEST(Da3Backbone, StoppingEarlyGivesTheSameLevels) {
  torch::NoGradGuard no_grad;
  const auto backbone = random_da3(small_da3());
  const auto images = random_images(3, 42, 28);
  const auto all = backbone->encode(images, 3);
  const auto two = backbone->encode(images, 1);
  ASSERT_EQ(all.size(), 4u);
  ASSERT_EQ(two.size(), 2u);
  EXPECT_EQ(all[0].sizes(), (std::vector<int64_t>{3, 1 + 3 * 2, 96}));
  EXPECT_TRUE(torch::equal(all[0], two[0]));
  EXPECT_TRUE(torch::equal(all[1], two[1]));
}

TEST(Da3Backbone, PropagatingALevelWithItsOwnClassTokensContinuesTheEncoder) {
  torch::NoGradGuard no_grad;
  const auto backbone = random_da3(small_da3());
  const auto levels = backbone->encode(random_images(3, 42, 28), 3);
  PropagationStart start;
  start.level = 1;
  start.tokens = levels[1];
  start.grid = {3, 3, 2};
  const auto propagated = backbone->propagate(start);
  ASSERT_EQ(propagated.size(), 3u);
  for (size_t i = 0; i < 3; ++i) {
    const auto expected = backbone->decodable(levels[i + 1]);
    EXPECT_LT(largest_difference(propagated[i].patches, expected.patches), 1e-6);
    EXPECT_LT(largest_difference(propagated[i].leading, levels[i + 1].narrow(1, 0, 1)), 1e-6);
  }
  // The local half stays raw, the current half is normalised.
  EXPECT_TRUE(torch::equal(propagated[0].patches.slice(2, 0, 48), levels[1].slice(1, 1).slice(2, 0, 48)));
  EXPECT_LT(propagated[0].patches.slice(2, 48).mean(-1).abs().max().item<double>(), 1e-5);
}

TEST(Da3Backbone, OnlyTheFirstViewIsSpecial) {
  torch::NoGradGuard no_grad;
  const auto backbone = random_da3(small_da3());
  const auto images = random_images(4, 28, 28);
  const auto swapped = images.index_select(0, torch::tensor({0, 3, 2, 1}));
  const auto level = backbone->encode(images, 3)[3], level_swapped = backbone->encode(swapped, 3)[3];
  EXPECT_LT(largest_difference(level.index_select(0, torch::tensor({0, 3, 2, 1})), level_swapped), 1e-4);
  const auto other_first = images.index_select(0, torch::tensor({1, 0, 2, 3}));
  EXPECT_GT(largest_difference(
                backbone->encode(other_first, 3)[3].index_select(0, torch::tensor({1, 0, 2, 3})), level),
            1e-2);
}

TEST(Da3Backbone, BlocksBeforeTheAlternationSeeOneView) {
  torch::NoGradGuard no_grad;
  auto options = small_da3();
  options.out_layers = {3, 5};
  const auto backbone = random_da3(options);
  const auto images = random_images(2, 28, 42);
  const auto together = backbone->encode(images, 1), alone = backbone->encode(images.slice(0, 0, 1), 1);
  // Products of more rows sum in another order, which random weights of this size make 2e-5 of.
  EXPECT_LT(largest_difference(together[0].slice(0, 0, 1), alone[0]), 1e-4);
  EXPECT_GT(largest_difference(together[1].slice(0, 0, 1), alone[1]), 1e-2);
}

TEST(Da3Backbone, RunsWithOtherSizesAndWithoutEachPart) {
  torch::NoGradGuard no_grad;
  struct Variant {
    nlohmann::json config;
    int64_t views, height, width, tokens;
  };
  const std::vector<Variant> variants = {
      {{{"embed_dim", 32}, {"num_heads", 8}, {"depth", 4}, {"out_layers", {1, 3}}, {"pos_embed_grid", 3}},
       1,
       14,
       14,
       1},
      {{{"embed_dim", 24},
        {"num_heads", 2},
        {"depth", 7},
        {"out_layers", {2, 3, 6}},
        {"pos_embed_grid", 4},
        {"patch_size", 8},
        {"alternating_start", 3},
        {"rope_start", 2},
        {"qk_norm_start", 0}},
       5,
       8,
       40,
       5},
      {{{"embed_dim", 30},
        {"num_heads", 3},
        {"depth", 3},
        {"out_layers", {0, 1, 2}},
        {"pos_embed_grid", 2},
        {"alternating_start", -1},
        {"rope_start", -1},
        {"qk_norm_start", -1},
        {"mlp_ratio", 1.5}},
       2,
       70,
       14,
       5},
      {{{"embed_dim", 32},
        {"num_heads", 4},
        {"depth", 6},
        {"out_layers", {4, 5}},
        {"pos_embed_grid", 37},
        {"alternating_start", 1},
        {"rope_start", 0},
        {"qk_norm_start", 5},
        {"ffn_layer", "swiglu"},
        {"rope_frequency", 50.5}},
       3,
       28,
       28,
       4},
  };
  for (const auto& variant : variants) {
    Da3BackboneOptions options;
    load_json(options, variant.config, "variant");
    check_options(options, "variant");
    const auto backbone = random_da3(options);
    const auto levels =
        backbone->encode(random_images(variant.views, variant.height, variant.width), options.levels() - 1);
    ASSERT_EQ(levels.size(), options.out_layers.size()) << variant.config;
    for (const auto& level : levels) {
      EXPECT_EQ(level.sizes(),
                (std::vector<int64_t>{variant.views, 1 + variant.tokens, options.level_channels()}));
      EXPECT_TRUE(torch::isfinite(level).all().item<bool>()) << variant.config;
    }
  }
}

TEST(Da3Backbone, PositionsAreResizedWithDinosOffsetScale) {
  torch::NoGradGuard no_grad;
  auto options = small_da3();
  options.pos_embed_grid = 20;
  const auto backbone = random_da3(options);
  auto tensors = named_tensors(*backbone);
  auto& table = tensors.at("pos_embed");
  // A table that rises by 1 a column and 100 a row: rows and columns are interpolated apart.
  const auto rows = torch::arange(20, torch::kFloat32).view({20, 1}) * 100;
  const auto columns = torch::arange(20, torch::kFloat32).view({1, 20});
  table.slice(1, 1).copy_((rows + columns).view({1, 400, 1}).expand({1, 400, 48}));
  table.slice(1, 0, 1).fill_(-7);

  const LatentGrid own = {1, 20, 20};
  EXPECT_TRUE(torch::equal(backbone->position_embedding(own), table));
  const LatentGrid grid = {1, 16, 10};
  const auto resized = backbone->position_embedding(grid);
  ASSERT_EQ(resized.sizes(), (std::vector<int64_t>{1, 161, 48}));
  EXPECT_EQ(resized[0][0][5].item<float>(), -7);
  const double row = 8.5 * 20 / 16.1 - 0.5, column = 4.5 * 20 / 10.1 - 0.5;
  EXPECT_NEAR(resized[0][1 + 8 * 10 + 4][0].item<double>(),
              100 * interpolated_index(row) + interpolated_index(column), 1e-3);
}

TEST(Da3Backbone, RefusesWhatDoesNotFitInOneSentence) {
  torch::NoGradGuard no_grad;
  const auto backbone = random_da3(small_da3());
  EXPECT_EQ(test::error_of([&] { backbone->encode(random_images(2, 30, 28), 1); }),
            "backbone: expected image sides that are positive multiples of 14 pixels, found 28x30; "
            "resize or crop the images.");
  EXPECT_EQ(test::error_of([&] {
              backbone->encode(torch::zeros({2, 1, 28, 28}), 1);
            }),
            "backbone: expected images (views, 3, height, width), found a tensor of shape [2, 1, 28, 28]; "
            "give at least one RGB image.");
  EXPECT_EQ(test::error_of([&] { backbone->encode(random_images(1, 28, 28), 4); }),
            "backbone: expected a level from 0 to 3, found 4; ask for a level that out_layers lists.");
  PropagationStart start;
  start.tokens = torch::zeros({2, 4, 96});
  start.grid = {2, 2, 2};
  EXPECT_EQ(test::error_of([&] { backbone->propagate(start); }),
            "propagation: expected tokens of shape [2, 5, 96], found [2, 4, 96]; "
            "put the leading tokens in front of the patches of the same token grid.");

  auto options = small_da3();
  options.num_heads = 5;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "num_heads: expected a divisor of embed_dim 48, found 5; change num_heads or embed_dim.");
  options.num_heads = 8;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "num_heads: expected a head size divisible by 4 for rotary positions, found 6; "
            "change num_heads, or set rope_start: -1.");
  options = small_da3();
  options.out_layers = {5, 5, 9};
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "out_layers: expected ascending block numbers below depth 12, found [5, 5, 9]; "
            "list the blocks after which the levels are taken.");
  options.out_layers = {5, 12};
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "out_layers: expected ascending block numbers below depth 12, found [5, 12]; "
            "list the blocks after which the levels are taken.");
}

TEST(Da3Backbone, InitialisationDependsOnTheSeedOnly) {
  const auto a = random_da3(small_da3(), 5), b = random_da3(small_da3(), 5);
  const auto c = random_da3(small_da3(), 6);
  const auto table_a = named_tensors(*a).at("pos_embed"), table_b = named_tensors(*b).at("pos_embed");
  EXPECT_TRUE(torch::equal(table_a, table_b));
  EXPECT_FALSE(torch::equal(table_a, named_tensors(*c).at("pos_embed")));
  EXPECT_LT(table_a.abs().max().item<double>(), 8 * 0.0401);
  EXPECT_NEAR(table_a.std().item<double>(), 8 * 0.02 * 0.8796, 0.01);  // a normal cut at two deviations
}

}  // namespace
}  // namespace gld
