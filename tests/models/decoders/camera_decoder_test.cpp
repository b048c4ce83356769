#include "models/decoders/camera_decoder.h"

#include "models/decoders/dpt_head.h"
#include "tests/models/decoders/small_dpt_head.h"
#include "tests/support/error_of.h"
#include "tests/support/largest_difference.h"

#include <cmath>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::largest_difference;
using test::random_head;

DptHeadOptions small_head() {
  DptHeadOptions options = test::small_dpt_head();
  options.camera_decoder = true;
  return options;
}

// The inputs are for the maps of the last two of three views.
GeometryInputs random_inputs(const LatentGrid& grid) {
  GeometryInputs inputs;
  for (uint64_t level = 0; level < 4; ++level) {
    inputs.levels.push_back(
        torch::randn({grid.views, grid.tokens_per_view(), 24}, at::detail::createCPUGenerator(10 + level)));
  }
  inputs.leading = torch::randn({3, 1, 24}, at::detail::createCPUGenerator(20));
  return inputs;
}

TEST(CameraDecoder, FindsACameraInEachViewsOwnToken) {
  const torch::NoGradGuard no_grad;
  CameraDecoder decoder(24, ParameterPlacement());
  for (auto& parameter : decoder.parameters()) parameter.normal_(0, 0.2, at::detail::createCPUGenerator(1));
  const auto tokens = torch::randn({5, 24}, at::detail::createCPUGenerator(2));
  const auto all = decoder.forward(tokens);
  ASSERT_EQ(all.sizes(), (std::vector<int64_t>{5, 9}));
  EXPECT_GE(all.narrow(1, 7, 2).min().item<double>(), 0);
  EXPECT_LT(largest_difference(all.narrow(0, 3, 1), decoder.forward(tokens.narrow(0, 3, 1))), 1e-5);
  EXPECT_EQ(
      test::error_of([&] { decoder.forward(tokens.narrow(1, 0, 20)); }),
      "camera decoder: expected camera tokens (views, 24), found a tensor of shape [5, 20]; give those of the "
      "last level.");
}

TEST(CameraDecoder, CamerasOfEncodingsHaveTheirSize) {
  const auto encodings = torch::tensor({{1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 2.0, 1.0, 1.5}}, torch::kFloat32);
  const auto cameras = decoded_cameras(encodings, {56, 42});
  ASSERT_EQ(cameras.size(), 1U);
  EXPECT_EQ(cameras[0].width, 56);
  EXPECT_LT((cameras[0].world_from_camera.linear() - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  EXPECT_NEAR(cameras[0].intrinsics(1, 1), 21 / std::tan(0.5), 1e-6);
  EXPECT_NEAR(cameras[0].intrinsics(0, 0), 28 / std::tan(0.75), 1e-6);
}

TEST(CameraDecoder, IsAPartOfTheHeadThatChangesNoMap) {
  const torch::NoGradGuard no_grad;
  const auto head = random_head(small_head());
  auto plain_options = small_head();
  plain_options.camera_decoder = false;
  const auto plain = std::make_shared<DptHead>(plain_options, ParameterPlacement());
  auto tensors = head->named_parameters();
  for (auto& item : plain->named_parameters()) item.value().set_data(tensors[item.key()]);

  const LatentGrid grid = {2, 2, 3};
  const auto inputs = random_inputs(grid);
  const auto maps = head->forward(inputs, grid, GeometryMaps::kDepthAndRays);
  const auto without = plain->forward(inputs, grid, GeometryMaps::kDepthAndRays);
  EXPECT_TRUE(torch::equal(maps.depth, without.depth));
  EXPECT_TRUE(torch::equal(maps.rays, without.rays));
  EXPECT_FALSE(without.camera_encodings.defined());
  ASSERT_EQ(maps.camera_encodings.sizes(), (std::vector<int64_t>{2, 9}));
  EXPECT_FALSE(head->forward(inputs, grid, GeometryMaps::kDepth).camera_encodings.defined());
  // Those of the last views; the first view's token is another's.
  auto alone = inputs;
  alone.leading = inputs.leading.slice(0, 1);
  EXPECT_TRUE(
      torch::equal(head->forward(alone, grid, GeometryMaps::kRays).camera_encodings, maps.camera_encodings));
  // Cameras of new weights look forward with a lens.
  for (const Camera& camera : decoded_cameras(maps.camera_encodings, {42, 28})) {
    EXPECT_LT(camera.intrinsics(0, 0), 1000);
  }
  alone.leading = torch::Tensor();
  EXPECT_EQ(
      test::error_of([&] { head->forward(alone, grid, GeometryMaps::kRays); }),
      "camera decoder: expected the last level's leading tokens of all views, found none of some views; "
      "propagate the levels with their leading tokens.");
}

}  // namespace
}  // namespace gld
