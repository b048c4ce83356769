#include "models/backbones/vggt_backbone.h"

#include "models/latent_spaces/latent_space.h"
#include "tests/support/error_of.h"
#include "tests/support/largest_difference.h"

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::largest_difference;

VggtBackboneOptions small_vggt() {
  VggtBackboneOptions options;
  options.embed_dim = 32;
  options.num_heads = 2;
  options.depth = 4;
  options.pos_embed_grid = 4;
  options.out_layers = {0, 1, 2, 3};
  options.patch_embed.sizes.depth = 1;
  return options;
}

std::shared_ptr<VggtBackbone> random_vggt() {
  auto backbone = std::make_shared<VggtBackbone>(small_vggt(), ParameterPlacement());
  torch::NoGradGuard no_grad;
  backbone->initialise(at::detail::createCPUGenerator(1));
  // Weights have the scale of a trained model, so that every part matters.
  for (auto& parameter : backbone->parameters()) {
    if (parameter.dim() > 1) parameter.mul_(8);
  }
  return backbone;
}

torch::Tensor random_images(int64_t views) {
  return torch::rand({views, 3, 42, 28}, at::detail::createCPUGenerator(2));
}

TEST(VggtBackbone, PropagatingALevelWithItsOwnTokensContinuesTheEncoder) {
  const torch::NoGradGuard no_grad;
  const auto backbone = random_vggt();
  const auto levels = backbone->encode(random_images(3), 3);
  ASSERT_EQ(levels.size(), 4U);
  EXPECT_EQ(levels[0].sizes(), (std::vector<int64_t>{3, 5 + 6, 64}));
  const auto propagated = backbone->propagate({1, levels[1], {3, 3, 2}});
  ASSERT_EQ(propagated.size(), 3U);
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_LT(largest_difference(propagated[i].patches, levels[i + 1].slice(1, 5)), 1e-6);
    EXPECT_LT(largest_difference(propagated[i].leading, levels[i + 1].narrow(1, 0, 5)), 1e-6);
  }
}

TEST(VggtBackbone, OnlyTheFirstViewIsSpecial) {
  const torch::NoGradGuard no_grad;
  const auto backbone = random_vggt();
  const auto images = random_images(3);
  const auto order = torch::tensor({0, 2, 1}), other_first = torch::tensor({1, 0, 2});
  const auto level = backbone->encode(images, 3)[3];
  EXPECT_LT(
      largest_difference(backbone->encode(images.index_select(0, order), 3)[3].index_select(0, order), level),
      1e-5);
  EXPECT_GT(
      largest_difference(
          backbone->encode(images.index_select(0, other_first), 3)[3].index_select(0, other_first), level),
      1e-2);
}

// New views get the tokens of a view behind the first; the published code's rule for DA3 would make all of them the
// first.
TEST(VggtBackbone, NewViewsGetTheTokensOfAFurtherView) {
  const torch::NoGradGuard no_grad;
  const auto backbone = random_vggt();
  const auto source = random_images(1);
  const auto pair = backbone->encode(torch::cat({source, source}), 1)[1];
  const auto rows = backbone->leading_for_propagation(source, 1);
  EXPECT_LT(largest_difference(rows, pair.narrow(1, 0, 5)), 1e-6);
  EXPECT_GT(largest_difference(rows[0], rows[1]), 1e-2);

  const LatentSpace space(backbone, 1);
  EXPECT_LT(largest_difference(space.leading_for_propagation(source, space.encode(source, 1)), rows), 1e-6);
  const LatentGrid grid = {3, 3, 2};
  const auto patches = torch::randn({3, 6, 64}, at::detail::createCPUGenerator(3));
  const auto completed = space.complete({{1, patches}}, rows, grid);
  const auto leading = torch::stack({rows[0], rows[1], rows[1]});
  const auto expected = backbone->propagate({1, torch::cat({leading, patches}, 1), grid});
  EXPECT_FALSE(completed.patches[0].defined());
  for (size_t i = 0; i < 3; ++i) EXPECT_TRUE(completed.patches[i + 1].equal(expected[i].patches));
  EXPECT_TRUE(completed.leading.equal(expected.back().leading));
}

TEST(VggtBackbone, RefusesInOneSentence) {
  const auto backbone = random_vggt();
  EXPECT_EQ(test::error_of([&] { backbone->encode(random_images(1), 4); }),
            "backbone: expected a level from 0 to 3, found 4; ask for a level that out_layers lists.");
  EXPECT_EQ(test::error_of([&] {
              backbone->propagate({1, torch::zeros({1, 6, 64}), {1, 3, 2}});
            }),
            "propagation: expected tokens of shape [1, 11, 64], found [1, 6, 64]; put the leading tokens in "
            "front of the patches of the same token grid.");
  auto options = small_vggt();
  options.out_layers = {0, 4};
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "out_layers: expected ascending numbers of pairs below depth 4, found [0, 4]; list the pairs after "
      "which the levels are taken.");
}

}  // namespace
}  // namespace gld
