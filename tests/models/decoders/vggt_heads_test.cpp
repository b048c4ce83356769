#include "models/decoders/vggt_heads.h"

#include "gld/photogrammetry/pose_from_rays.h"
#include "models/decoders/geometry_head_registry.h"
#include "models/scene_geometry/predicted_cameras.h"
#include "tests/support/error_of.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Cameras go into rays and come out of them again, so that all that takes DA3's rays takes VGGT's.
TEST(VggtCameras, AreFoundAgainInTheirRays) {
  VggtCameras cameras;
  cameras.encoding = torch::tensor(
      {{0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.8, 1.0}, {0.3, -0.2, 0.5, 0.1, 0.2, -0.1, 0.9, 0.7, 0.9}});
  constexpr int64_t kHeight = 56, kWidth = 70;
  GeometryOutput geometry;
  geometry.rays = cameras.rays(32, 40);
  geometry.ray_confidence = torch::full({2, 32, 40}, VggtHeads::kRayConfidence);
  Camera given;
  given.width = kWidth;
  given.height = kHeight;
  given.intrinsics(0, 2) = kWidth / 2.0;
  given.intrinsics(1, 2) = kHeight / 2.0;
  const auto found = predicted_cameras(geometry, {given, given});
  const auto poses = cameras.camera_from_world(), intrinsics = cameras.intrinsics(kHeight, kWidth);
  for (int64_t view = 0; view < 2; ++view) {
    const auto& camera = found[static_cast<size_t>(view)];
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 4; ++column) {
        EXPECT_NEAR(camera.camera_from_world().matrix()(row, column), poses[view][row][column].item<double>(),
                    1e-4);
      }
    }
    for (const int axis : {0, 1}) {
      EXPECT_NEAR(camera.intrinsics(axis, axis) / intrinsics[view][axis][axis].item<double>(), 1, 1e-4);
    }
  }
}

VggtHeadsOptions small_vggt_heads() {
  VggtHeadsOptions options;
  options.dim_in = 32;
  options.features = 16;
  options.out_channels = {8, 8, 12, 16};
  options.camera.trunk_depth = 1;
  options.camera.num_heads = 2;
  return options;
}

TEST(VggtHeads, CamerasAreOfAllViewsAndMapsOfThoseAskedFor) {
  const torch::NoGradGuard no_grad;
  VggtHeads heads(small_vggt_heads(), ParameterPlacement());
  heads.initialise(at::detail::createCPUGenerator(1));
  GeometryInputs all, last;
  for (int level = 0; level < 4; ++level) {
    all.levels.push_back(torch::randn({3, 6, 32}, at::detail::createCPUGenerator(level)));
    last.levels.push_back(all.levels.back().slice(0, 1));
  }
  all.leading = last.leading = torch::randn({3, 5, 32}, at::detail::createCPUGenerator(9));
  const auto of_all = heads.forward(all, {3, 3, 2}, GeometryMaps::kDepthAndRays);
  const auto of_last = heads.forward(last, {2, 3, 2}, GeometryMaps::kDepthAndRays);
  EXPECT_EQ(of_all.depth.sizes(), (std::vector<int64_t>{3, 42, 28}));
  EXPECT_EQ(of_all.points.sizes(), (std::vector<int64_t>{3, 42, 28, 3}));
  EXPECT_EQ(of_all.rays.sizes(), (std::vector<int64_t>{3, 24, 16, 6}));
  EXPECT_GT(of_all.depth.min().item<double>(), 0);
  EXPECT_TRUE(of_all.rays.isfinite().all().item<bool>());
  EXPECT_TRUE(torch::allclose(of_last.rays, of_all.rays.slice(0, 1)));
  EXPECT_TRUE(torch::allclose(of_last.points, of_all.points.slice(0, 1), 1e-4, 1e-5));
  EXPECT_FALSE(heads.forward(all, {3, 3, 2}, GeometryMaps::kDepth).rays.defined());

  auto without = small_vggt_heads();
  EXPECT_TRUE(GeometryHeadOptions(without).predicts_rays());
  without.camera_head = without.point_head = false;
  EXPECT_FALSE(GeometryHeadOptions(without).predicts_rays());
  EXPECT_FALSE(GeometryHeadOptions::none().predicts_rays());
  VggtHeads depth_only(without, ParameterPlacement());
  depth_only.initialise(at::detail::createCPUGenerator(1));
  EXPECT_FALSE(depth_only.forward(all, {3, 3, 2}, GeometryMaps::kDepth).points.defined());
  EXPECT_EQ(test::error_of([&] {
              depth_only.forward(all, {3, 3, 2}, GeometryMaps::kDepthAndRays);
            }),
            "rays: expected a model with a camera head, found a VGGT model without one; ask for images and "
            "depth alone, or convert a file that has the tensors camera_head.*.");
}

}  // namespace
}  // namespace gld
