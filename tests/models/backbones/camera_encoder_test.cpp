#include "models/backbones/camera_encoder.h"

#include "models/backbones/da3_backbone.h"
#include "models/backbones/vggt_backbone.h"
#include "tests/models/backbones/small_da3.h"
#include "tests/support/error_of.h"
#include "tests/support/largest_difference.h"
#include "tests/support/random_cameras.h"

#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::largest_difference;
using test::random_da3;

std::vector<Camera> cameras_at(const std::vector<double>& distances) {
  test::RandomCameras random(4);
  std::vector<Camera> cameras;
  for (const double distance : distances) {
    Camera camera = random.ordinary(28, 42);
    camera.world_from_camera.translation() = Eigen::Vector3d(distance, 0, 0);
    cameras.push_back(camera);
  }
  return cameras;
}

// Seen from another world: turned, moved and of another unit.
std::vector<Camera> moved(std::vector<Camera> cameras, double scale) {
  test::RandomCameras random(5);
  Eigen::Isometry3d motion = Eigen::Isometry3d::Identity();
  motion.linear() = random.rotation(3);
  motion.translation() = random.vector(10);
  for (Camera& camera : cameras) {
    camera.world_from_camera.translation() *= scale;
    camera.world_from_camera = motion * camera.world_from_camera;
  }
  return cameras;
}

Da3BackboneOptions da3_with_encoder() {
  Da3BackboneOptions options = test::small_da3();
  options.camera_encoder_depth = 2;
  options.camera_encoder_heads = 4;
  return options;
}

torch::Tensor images_in_range(int64_t views) {
  return torch::rand({views, 3, 42, 28}, at::detail::createCPUGenerator(2));
}

TEST(NormalisedCameras, StandAroundTheFirstInTheUnitOfTheirMedianDistance) {
  const auto normalised = normalised_cameras(moved(cameras_at({0, 2, 8, 3, 5}), 1.5));
  EXPECT_NEAR(normalised.unit, 4.5, 1e-12);  // of 0, 3, 4.5, 7.5, 12
  const std::vector<double> expected = {0, 3 / 4.5, 12 / 4.5, 1, 7.5 / 4.5};
  for (size_t i = 0; i < expected.size(); ++i) {
    EXPECT_NEAR(normalised.cameras[i].world_from_camera.translation().norm(), expected[i], 1e-12);
  }
  EXPECT_LT((normalised.cameras[0].world_from_camera.matrix() - Eigen::Matrix4d::Identity()).norm(), 1e-12);
}

// As published: the lower of two in the middle, 0 among them, and never below 0.1.
TEST(NormalisedCameras, OfTwoTheUnitIsATenthAndOfFourTheLowerMiddle) {
  EXPECT_EQ(normalised_cameras(cameras_at({0, 7})).unit, 0.1);
  EXPECT_NEAR(normalised_cameras(cameras_at({0, 9, 2, 4})).unit, 2, 1e-12);
  EXPECT_EQ(normalised_cameras(cameras_at({3, 3, 3})).unit, 0.1);
  EXPECT_EQ(normalised_cameras(cameras_at({5})).unit, 0.1);
  EXPECT_EQ(test::error_of([] { normalised_cameras({}); }),
            "known cameras: expected at least one camera, found none; give one for each view.");
}

TEST(KnownCameras, AreToldWhateverTheirWorldAndUnit) {
  const torch::NoGradGuard no_grad;
  const auto backbone = random_da3(da3_with_encoder());
  const auto images = images_in_range(3);
  const auto cameras = cameras_at({0, 2, 5});
  const auto levels = backbone->encode_with_cameras(images, 3, cameras);
  ASSERT_EQ(levels.size(), 4U);
  const auto elsewhere = backbone->encode_with_cameras(images, 3, moved(cameras, 3));
  EXPECT_LT(largest_difference(levels[3], elsewhere[3]), 1e-3 * levels[3].abs().max().item<double>());
  auto pixels = cameras;
  for (Camera& camera : pixels) {
    camera.width *= 3;
    camera.height *= 3;
    camera.intrinsics.topRows<2>() *= 3;
  }
  EXPECT_LT(largest_difference(levels[3], backbone->encode_with_cameras(images, 3, pixels)[3]), 1e-4);
  // And they matter: this is another pose of one view, another lens, or none told at all.
  auto other = cameras;
  other[2].world_from_camera.translation() += Eigen::Vector3d(0, 2, 0);
  EXPECT_GT(largest_difference(levels[0].narrow(0, 0, 1),
                               backbone->encode_with_cameras(images, 3, other)[0].narrow(0, 0, 1)),
            1e-3);
  other = cameras;
  other[1].intrinsics(0, 0) *= 2;
  EXPECT_GT(largest_difference(levels[0], backbone->encode_with_cameras(images, 3, other)[0]), 1e-3);
  EXPECT_GT(largest_difference(levels[0], backbone->encode(images, 0)[0]), 1e-3);
}

// What the encoder says takes the place of the learned tokens and of nothing else.
TEST(KnownCameras, TokensLikeTheLearnedOnesGiveTheLevelsWithoutCameras) {
  const torch::NoGradGuard no_grad;
  const auto backbone = random_da3(da3_with_encoder());
  const auto images = images_in_range(1);
  const auto cameras = cameras_at({0});
  backbone->named_parameters()["camera_token"].slice(1, 0, 1).copy_(backbone->camera_tokens(cameras));
  EXPECT_TRUE(
      torch::equal(backbone->encode_with_cameras(images, 3, cameras)[3], backbone->encode(images, 3)[3]));
}

TEST(KnownCameras, AnEncoderLeavesEverythingElseAsItWas) {
  const torch::NoGradGuard no_grad;
  auto without = da3_with_encoder();
  without.camera_encoder_depth = 0;
  const auto plain = std::make_shared<Da3Backbone>(without, ParameterPlacement());
  const auto backbone = random_da3(da3_with_encoder());
  auto tensors = backbone->named_parameters();
  for (auto& item : plain->named_parameters()) item.value().set_data(tensors[item.key()]);
  const auto images = images_in_range(2);
  EXPECT_TRUE(torch::equal(plain->encode(images, 3)[3], backbone->encode(images, 3)[3]));
  EXPECT_TRUE(without.published_elsewhere().empty());
  EXPECT_EQ(da3_with_encoder().published_elsewhere().size(), 1U);
}

TEST(KnownCameras, WhatCannotBeToldIsNamed) {
  const auto images = images_in_range(2);
  auto without = da3_with_encoder();
  without.camera_encoder_depth = 0;
  EXPECT_EQ(
      test::error_of([&] {
        random_da3(without)->encode_with_cameras(images, 0, cameras_at({0, 1}));
      }),
      "known cameras: expected a model with a camera encoder, found one without; convert a file that has the "
      "tensors model.cam_enc.*, or let the model find the cameras itself.");
  EXPECT_EQ(test::error_of(
                [&] { random_da3(da3_with_encoder())->encode_with_cameras(images, 0, cameras_at({0})); }),
            "known cameras: expected one for each of 2 images, found 1; give the cameras of these views.");
  auto options = da3_with_encoder();
  options.camera_encoder_heads = 5;
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "camera_encoder_heads: expected a divisor of embed_dim 48, found 5; change camera_encoder_heads.");
  options = da3_with_encoder();
  options.alternating_start = -1;
  EXPECT_NE(test::error_of([&] { options.check(); }).find("such a model has no camera token"),
            std::string::npos);
  ParameterPlacement nowhere;
  nowhere.device = torch::kMeta;
  EXPECT_EQ(
      test::error_of([&] {
        VggtBackboneOptions().make(nowhere)->encode_with_cameras(images, 0, cameras_at({0, 1}));
      }),
      "known cameras: expected a backbone with an encoder for cameras, found one of kind vggt without one; use "
      "a model that has one, or let it find the cameras itself.");
}

}  // namespace
}  // namespace gld
