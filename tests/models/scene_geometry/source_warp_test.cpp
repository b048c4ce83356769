#include "models/scene_geometry/source_warp.h"

#include "gld/photogrammetry/picture_warp.h"
#include "gld/photogrammetry/pose_from_rays.h"
#include "tests/support/error_of.h"
#include "tests/support/textured_plane.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;
using test::camera_before_plane;

constexpr double kUnit = 2.5;  // of the model's depth, in the world

struct PlaneScene {
  Views views;
  torch::Tensor images;  // of all views
  GeometryOutput geometry;
};

torch::Tensor picture_of(const PicturedView& view) {
  return torch::tensor(view.rgb).view({view.height, view.width, 3}).permute({2, 0, 1});
}

// Returns what a geometry head that knows the plane says of the source views.
PlaneScene plane_scene(const std::vector<Camera>& cameras, int64_t num_sources) {
  const test::TexturedPlane plane;
  PlaneScene scene;
  scene.views.cameras = cameras;
  scene.views.num_sources = num_sources;
  std::vector<torch::Tensor> images, depths, rays;
  for (const Camera& camera : cameras) {
    const PicturedView seen = plane.seen_by(camera, kUnit);
    images.push_back(picture_of(seen));
    if (static_cast<int64_t>(images.size()) > num_sources) continue;
    depths.push_back(torch::tensor(seen.depth.values).view({seen.depth.height, seen.depth.width}));
    Camera in_model = camera;
    in_model.world_from_camera.translation() /= kUnit;
    rays.push_back(torch::tensor(rays_of_camera(in_model, 16, 12).values).view({12, 16, 6}));
  }
  scene.images = torch::stack(images);
  scene.geometry.depth = torch::stack(depths);
  scene.geometry.rays = torch::stack(rays);
  scene.geometry.ray_confidence = torch::full({num_sources, 12, 16}, 2.0F);
  scene.geometry.depth_confidence = torch::full_like(scene.geometry.depth, 2.0F);
  return scene;
}

std::vector<Camera> four_cameras() {
  return {camera_before_plane({0, 0, 0}, 0), camera_before_plane({1.4, 0.2, 0.1}, -0.3),
          camera_before_plane({0.3, 0.1, 0}, -0.06), camera_before_plane({1.2, 0.1, 0.1}, -0.25)};
}

SourceDepth depth_of(const PlaneScene& scene) {
  return source_depth_of_head(scene.views, scene.images.narrow(0, 0, scene.views.num_sources), scene.geometry,
                              /*single_source_unit=*/0);
}

TEST(SourceWarp, PhotographsLieWhereTheTargetsSeeThemTheNearestFirst) {
  const PlaneScene scene = plane_scene(four_cameras(), 2);
  const SourceWarp warp = warp_sources(scene.views, scene.images.narrow(0, 0, 2), depth_of(scene), 2);
  EXPECT_EQ(warp.doubt, "");
  ASSERT_EQ(warp.agreement.sizes(), (std::vector<int64_t>{2, 2, 72, 96}));
  ASSERT_EQ(warp.completed.sizes(), (std::vector<int64_t>{2, 3, 72, 96}));
  EXPECT_LT((warp.completed - scene.images.narrow(0, 2, 2)).abs().mean().item<double>(), 0.03);
  const test::TexturedPlane plane;
  const std::vector<PicturedView> sources{plane.seen_by(scene.views.cameras[0], 1),
                                          plane.seen_by(scene.views.cameras[1], 1)};
  for (int64_t target = 0; target < 2; ++target) {
    EXPECT_LE(warp.agreement.max().item<double>(), 1);
    EXPECT_GT(warp.agreement[target].mean().item<double>(), 0.75);  // they show the same plane
    // View 2 stands beside view 0 and view 3 beside view 1.
    const auto own = carry_pictures(sources, scene.views.cameras[static_cast<size_t>(2 + target)]);
    for (const int64_t number : {int64_t{0}, int64_t{1}}) {
      const auto seen = (warp.agreement[target][number] > 0).to(torch::kFloat32).mean().item<double>();
      EXPECT_NEAR(seen, own[static_cast<size_t>(number == 0 ? target : 1 - target)].seen_share(), 0.01);
    }
    EXPECT_GT(std::abs(own[0].seen_share() - own[1].seen_share()), 0.02);
  }
  // It takes one of them: the first.
  const SourceWarp one = warp_sources(scene.views, scene.images.narrow(0, 0, 2), depth_of(scene), 1);
  EXPECT_TRUE(torch::equal(one.agreement, warp.agreement.narrow(1, 0, 1)));
  // It takes more than there are: the rest is empty.
  const SourceWarp three = warp_sources(scene.views, scene.images.narrow(0, 0, 2), depth_of(scene), 3);
  EXPECT_TRUE(torch::equal(three.agreement.narrow(1, 0, 2), warp.agreement));
  EXPECT_EQ(three.agreement.narrow(1, 2, 1).abs().max().item<double>(), 0);
}

TEST(SourceWarp, TheDepthOfTheNearestSourceIsInTheSceneUnit) {
  const PlaneScene scene = plane_scene(four_cameras(), 2);
  const auto nearest = nearest_source_depth(scene.views, depth_of(scene));
  EXPECT_EQ(nearest.doubt, "");
  ASSERT_EQ(nearest.depth.sizes(), (std::vector<int64_t>{2, 72, 96}));
  const test::TexturedPlane plane;
  for (int64_t target = 0; target < 2; ++target) {
    const auto truth = plane.seen_by(scene.views.cameras[static_cast<size_t>(2 + target)], 1).depth;
    const auto error = (nearest.depth[target] / torch::tensor(truth.values).view({72, 96}) - 1).abs();
    EXPECT_LT(error.mean().item<double>(), 0.02) << target;
  }
  const PlaneScene alone = plane_scene({four_cameras()[0], four_cameras()[1]}, 1);
  const auto none = nearest_source_depth(alone.views, depth_of(alone));
  EXPECT_EQ(none.doubt, "the depth of a single source view has no scale");
  EXPECT_FALSE(none.depth.defined());
}

TEST(SourceWarp, NothingIsCarriedWhereTheScaleIsOpen) {
  const auto cameras = four_cameras();
  const PlaneScene alone = plane_scene({cameras[0], cameras[1]}, 1);
  const SourceWarp none = warp_sources(alone.views, alone.images.narrow(0, 0, 1), depth_of(alone), 2);
  EXPECT_EQ(none.doubt, "the depth of a single source view has no scale");
  ASSERT_EQ(none.agreement.sizes(), (std::vector<int64_t>{1, 2, 72, 96}));
  EXPECT_EQ(none.agreement.abs().max().item<double>(), 0);
  EXPECT_FALSE(none.completed.defined());

  // At one place there is no parallax.
  const PlaneScene on_the_spot =
      plane_scene({cameras[0], camera_before_plane({0, 0, 0}, 0.1), cameras[2]}, 2);
  const SourceWarp turned =
      warp_sources(on_the_spot.views, on_the_spot.images.narrow(0, 0, 2), depth_of(on_the_spot), 1);
  EXPECT_THAT(turned.doubt, testing::StartsWith("the unit of the source views' depth is not known ("));
  EXPECT_EQ(turned.agreement.abs().max().item<double>(), 0);
}

// Depth may come from elsewhere: it is used as it is, in the unit of the cameras, and one source is enough then.
TEST(SourceWarp, GivenDepthCarriesASingleSource) {
  const PlaneScene alone = plane_scene({four_cameras()[0], four_cameras()[2]}, 1);
  const test::TexturedPlane plane;
  SourceDepth given;
  given.from = "a sensor";
  given.views = {plane.seen_by(alone.views.cameras[0], 1).depth};
  const SourceWarp warp = warp_sources(alone.views, alone.images.narrow(0, 0, 1), given, 2);
  EXPECT_EQ(warp.doubt, "");
  ASSERT_TRUE(warp.completed.defined());
  // As far as two sources carry it in the test above.
  EXPECT_LT((warp.completed - alone.images.narrow(0, 1, 1)).abs().mean().item<double>(), 0.03);
  EXPECT_GT((warp.agreement[0][0] > 0).to(torch::kFloat32).mean().item<double>(), 0.5);
  // Half of the map is not known, which says nothing of the rest.
  auto& depth = given.views[0];
  std::fill(depth.values.begin(), depth.values.begin() + static_cast<std::ptrdiff_t>(depth.values.size() / 2),
            0.0F);
  const SourceWarp half = warp_sources(alone.views, alone.images.narrow(0, 0, 1), given, 1);
  EXPECT_NEAR((half.agreement[0][0] > 0).to(torch::kFloat32).mean().item<double>(), 0.45, 0.1);
  given.views.clear();
  given.doubt = "the sensor was off";
  EXPECT_EQ(warp_sources(alone.views, alone.images.narrow(0, 0, 1), given, 1).doubt, "the sensor was off");
  given.views.resize(2);
  EXPECT_EQ(test::error_of([&] { warp_sources(alone.views, alone.images.narrow(0, 0, 1), given, 1); }),
            "depth of the source views: expected a map for each of 1 source views, found 2; give as many.");
}

}  // namespace
}  // namespace gld
