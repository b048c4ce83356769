#include "models/decoders/dpt_head.h"

#include "gld/base/configuration.h"
#include "models/weights/weight_loading.h"
#include "tests/models/decoders/small_dpt_head.h"
#include "tests/support/error_of.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::random_head;
using test::small_dpt_head;

std::vector<torch::Tensor> random_levels(const LatentGrid& grid, int64_t channels) {
  std::vector<torch::Tensor> levels;
  for (uint64_t level = 0; level < 4; ++level) {
    levels.push_back(torch::randn({grid.views, grid.tokens_per_view(), channels},
                                  at::detail::createCPUGenerator(10 + level)));
  }
  return levels;
}

TEST(DptHead, GivesMapsOfTheDocumentedShapesOnOddGrids) {
  torch::NoGradGuard no_grad;
  const auto head = random_head(small_dpt_head());
  for (const auto& grid : {LatentGrid{1, 1, 1}, LatentGrid{2, 5, 3}, LatentGrid{3, 1, 6}}) {
    const auto maps = head->forward(random_levels(grid, 24), grid, GeometryMaps::kDepthAndRays);
    const int64_t height = grid.height * 14, width = grid.width * 14;
    EXPECT_EQ(maps.depth.sizes(), (std::vector<int64_t>{grid.views, height, width}));
    EXPECT_EQ(maps.depth_confidence.sizes(), (std::vector<int64_t>{grid.views, height, width}));
    EXPECT_EQ(maps.rays.sizes(), (std::vector<int64_t>{grid.views, 8 * grid.height, 8 * grid.width, 6}));
    EXPECT_EQ(maps.ray_confidence.sizes(),
              (std::vector<int64_t>{grid.views, 8 * grid.height, 8 * grid.width}));
    EXPECT_GT(maps.depth.min().item<double>(), 0);
    EXPECT_GT(maps.depth_confidence.min().item<double>(), 1);
    EXPECT_TRUE(torch::isfinite(maps.rays).all().item<bool>());
  }
}

TEST(DptHead, ComputesOnlyTheMapsThatWereAskedFor) {
  torch::NoGradGuard no_grad;
  const auto head = random_head(small_dpt_head());
  const LatentGrid grid = {2, 2, 3};
  const auto levels = random_levels(grid, 24);
  const auto both = head->forward(levels, grid, GeometryMaps::kDepthAndRays);
  const auto depth = head->forward(levels, grid, GeometryMaps::kDepth);
  const auto rays = head->forward(levels, grid, GeometryMaps::kRays);
  EXPECT_FALSE(depth.rays.defined());
  EXPECT_FALSE(rays.depth.defined());
  EXPECT_TRUE(torch::equal(depth.depth, both.depth));
  EXPECT_TRUE(torch::equal(rays.rays, both.rays));
}

TEST(DptHead, AViewDoesNotDependOnTheOthersOrOnItsChunk) {
  torch::NoGradGuard no_grad;
  const auto head = random_head(small_dpt_head());
  // 18 x 18 patches are a quarter of a chunk, so seven views are cut into 4 + 3.
  const LatentGrid grid = {7, 18, 18}, one = {1, 18, 18};
  const auto levels = random_levels(grid, 24);
  const auto all = head->forward(levels, grid, GeometryMaps::kDepthAndRays);
  for (const int64_t view : {0, 3, 6}) {
    std::vector<torch::Tensor> own;
    own.reserve(levels.size());
    for (const auto& level : levels) own.push_back(level.narrow(0, view, 1));
    const auto alone = head->forward(own, one, GeometryMaps::kDepthAndRays);
    EXPECT_LT((alone.depth[0] - all.depth[view]).abs().max().item<double>(), 1e-5);
    EXPECT_LT((alone.rays[0] - all.rays[view]).abs().max().item<double>(), 1e-5);
  }
}

TEST(DptHead, LogitsBelowTheBoundKeepTheirExponential) {
  torch::NoGradGuard no_grad;
  const auto head = random_head(small_dpt_head());
  auto tensors = named_tensors(*head);
  const LatentGrid grid = {1, 2, 2};
  const auto levels = random_levels(grid, 24);
  // Up to the bound, the exponential is untouched: a bias of 50 multiplies depth by exp(50). The logit is a sum of 32
  // products and the bias in float32, in any order, each partial sum below 64 and so rounded by at most 2^-19; the
  // exponential makes that absolute error a relative one of depth.
  tensors.at("scratch.output_conv2.2.bias").zero_();
  const auto base = head->forward(levels, grid, GeometryMaps::kDepth).depth;
  tensors.at("scratch.output_conv2.2.bias").fill_(50);
  const auto shifted = head->forward(levels, grid, GeometryMaps::kDepth).depth;
  EXPECT_LT((shifted.to(torch::kFloat64) / (base.to(torch::kFloat64) * std::exp(50.0)) - 1)
                .abs()
                .max()
                .item<double>(),
            (DptTrunk::kHiddenChannels + 1) * std::exp2(-19));
}

TEST(DptHead, RunsWithEveryOption) {
  torch::NoGradGuard no_grad;
  const LatentGrid grid = {1, 2, 3};
  DptHeadOptions options = small_dpt_head();
  load_json(options,
            {{"pos_embed", false}, {"down_ratio", 2}, {"aux_pyramid_levels", 1}, {"aux_out1_conv_num", 3}},
            "test");
  const auto head = random_head(options);
  const auto maps = head->forward(random_levels(grid, 24), grid, GeometryMaps::kDepthAndRays);
  EXPECT_EQ(maps.depth.sizes(), (std::vector<int64_t>{1, 14, 21}));
  EXPECT_EQ(named_tensors(*head).count("scratch.output_conv1_aux.0.2.weight"), 1u);
  EXPECT_EQ(named_tensors(*head).count("scratch.output_conv1_aux.1.0.weight"), 0u);
}

TEST(DptHead, RefusesWhatDoesNotFitInOneSentence) {
  const auto head = random_head(small_dpt_head());
  const LatentGrid grid = {2, 2, 2};
  auto levels = random_levels(grid, 24);
  levels.pop_back();
  EXPECT_EQ(test::error_of([&] { head->forward(levels, grid, GeometryMaps::kDepth); }),
            "DPT head: expected four levels of at least one view, found 3 levels; give levels 0 to 3.");
  levels.push_back(torch::zeros({2, 5, 24}));
  EXPECT_EQ(test::error_of([&] { head->forward(levels, grid, GeometryMaps::kDepth); }),
            "DPT head: expected levels of shape [2, 4, 24], found [2, 5, 24]; "
            "give the decodable patch tokens of every view.");
  auto options = small_dpt_head();
  options.out_channels = {8, 12, 16};
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "out_channels: expected four numbers divisible by 4, found [8, 12, 16]; "
            "give the channels of the four levels' projections.");
  options = small_dpt_head();
  options.features = 20;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "features: expected a number divisible by 8, found 20; change features.");
  options = small_dpt_head();
  options.aux_out1_conv_num = 2;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "aux_out1_conv_num: expected 1, 3 or 5, found 2; change aux_out1_conv_num.");
}

}  // namespace
}  // namespace gld
