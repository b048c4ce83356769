#include "models/refiner/stacked_levels.h"

#include "models/refiner/latent_refining.h"

#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

// A view's tokens row by row, the channels of one level behind those of the other, special tokens left out.
TEST(StackedLevels, AreMapsOfPatchTokens) {
  const LatentGrid grid{2, 2, 3};
  const auto one = torch::arange(2 * 7 * 2).view({2, 7, 2}).to(torch::kFloat32);  // one special token
  const auto other = 100 + torch::arange(2 * 6 * 1).view({2, 6, 1}).to(torch::kFloat32);
  const auto maps = stacked_levels({one, other}, grid);
  ASSERT_EQ(maps.sizes(), (std::vector<int64_t>{2, 3, 2, 3}));
  for (int64_t view = 0; view < 2; ++view) {
    for (int64_t row = 0; row < 2; ++row) {
      for (int64_t column = 0; column < 3; ++column) {
        const int64_t token = 3 * row + column;
        for (int64_t channel = 0; channel < 2; ++channel) {
          EXPECT_EQ(maps[view][channel][row][column].item<float>(),
                    one[view][1 + token][channel].item<float>());
        }
        EXPECT_EQ(maps[view][2][row][column].item<float>(), other[view][token][0].item<float>());
      }
    }
  }
}

TEST(StackedLevels, GoBackIntoTheViewsThatTheyAreOf) {
  const LatentGrid grid{3, 2, 2};
  torch::manual_seed(1);
  const std::vector<torch::Tensor> levels{torch::randn({3, 5, 4}), torch::randn({3, 4, 4})};
  const auto maps = stacked_levels(levels, grid);
  const auto same = with_stacked_levels(levels, maps.slice(0, 1), 1);
  for (size_t level = 0; level < levels.size(); ++level)
    EXPECT_TRUE(torch::equal(same[level], levels[level]));
  const auto other = with_stacked_levels(levels, maps.slice(0, 1) + 1, 1);
  for (size_t level = 0; level < levels.size(); ++level) {
    const int64_t special = level == 0 ? 1 : 0;
    EXPECT_TRUE(torch::equal(other[level][0], levels[level][0])) << "the first view is not among them";
    EXPECT_TRUE(torch::equal(other[level].slice(1, 0, special), levels[level].slice(1, 0, special)));
    EXPECT_TRUE(torch::allclose(other[level].slice(0, 1).slice(1, special),
                                levels[level].slice(0, 1).slice(1, special) + 1));
  }
}

TEST(BesideReferences, TakesTheNearestFirst) {
  std::vector<Camera> cameras(3);
  for (size_t i = 0; i < cameras.size(); ++i)
    cameras[i].world_from_camera.translation() = Eigen::Vector3d(static_cast<double>(i), 0, 0);
  Camera between;
  between.world_from_camera.translation() = Eigen::Vector3d(1.8, 0, 0);
  RefinerOptions options;
  options.attention = ViewAttention::kSelf;
  options.references = 2;
  const auto encoded = torch::arange(3).view({3, 1, 1, 1}).to(torch::kFloat32);
  const auto seen = beside_references(options, between, torch::full({1, 1, 1}, 9), cameras, encoded);
  EXPECT_TRUE(torch::equal(seen.flatten(), torch::tensor({9.0F, 2.0F, 1.0F})));
  // A picture of three cells would leave one empty.
  options.attention = ViewAttention::kGrid;
  EXPECT_EQ(references_taken(options, 3), 1);
  EXPECT_EQ(beside_references(options, between, torch::full({1, 1, 1}, 9), cameras, encoded).size(0), 2);
}

}  // namespace
}  // namespace gld
