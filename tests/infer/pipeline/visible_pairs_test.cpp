#include "infer/pipeline/visible_pairs.h"

#include "gld/cameras/pose_from_rays.h"
#include "infer/pipeline/bundle_models.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/random_cameras.h"
#include "tests/support/temporary_folder.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr double kUnit = 0.37;  // of the model's depth, in world units
const ImageSize kPicture{56, 42};

Camera camera_at(const Eigen::Vector3d& centre) {
  Camera camera;
  camera.width = kPicture.width;
  camera.height = kPicture.height;
  camera.intrinsics << 48, 0, 28, 0, 48, 21, 0, 0, 1;
  camera.world_from_camera.translation() = centre;
  return camera;
}

// Three rooms in a row along z, 4 units long; in each a source view 0.5 behind the wall, and a target beside it.
Views rooms_in_a_row() {
  Views views;
  views.num_sources = 3;
  for (int room = 0; room < 3; ++room) views.cameras.push_back(camera_at({0.2 * room, 0, 4.0 * room + 0.5}));
  for (int room = 0; room < 3; ++room) views.cameras.push_back(camera_at({0.3, 0.1, 4.0 * room + 0.8}));
  return views;
}

// What a DPT head that knows the scene says of its sources: everything is 3.5 away, its frame is turned and its unit
// its own. `turn` (radians) spoils the cameras of its rays.
GeometryOutput true_geometry(const Views& views, double turn = 0) {
  test::RandomCameras random(3);
  const Eigen::Matrix3d frame = random.rotation(2);
  GeometryOutput geometry;
  std::vector<torch::Tensor> rays;
  for (int64_t i = 0; i < views.num_sources; ++i) {
    Camera camera = views.cameras[static_cast<size_t>(i)];
    camera.world_from_camera.linear() =
        frame * camera.world_from_camera.linear() *
        Eigen::AngleAxisd(i % 2 == 0 ? turn : -turn, Eigen::Vector3d::UnitX()).toRotationMatrix();
    camera.world_from_camera.translation() = (frame * camera.world_from_camera.translation() / kUnit).eval();
    const RayMap map = rays_of_camera(camera, 16, 12);
    rays.push_back(torch::tensor(map.values).view({12, 16, 6}));
  }
  geometry.rays = torch::stack(rays);
  geometry.ray_confidence = torch::full({views.num_sources, 12, 16}, 2.0F);
  geometry.depth = torch::full({views.num_sources, kPicture.height, kPicture.width}, 3.5 / kUnit);
  geometry.depth_confidence = torch::full_like(geometry.depth, 2.0F);
  return geometry;
}

TEST(VisiblePairs, DepthIsBroughtToTheUnitOfTheCameras) {
  const Views views = rooms_in_a_row();
  EXPECT_TRUE(visible_pairs(views).visibility.all());
  const auto pairs = visible_pairs(views, true_geometry(views));
  EXPECT_TRUE(pairs.warnings.empty());
  EXPECT_TRUE(pairs.visibility.used_depth);
  std::vector<PlanarDepth> depth;
  depth.reserve(3);
  for (int i = 0; i < 3; ++i) depth.push_back({4, 3, std::vector<float>(12, 3.5F)});
  EXPECT_EQ(pairs.visibility.attends, view_visibility(views, depth).attends);
  EXPECT_FALSE(pairs.visibility.attends_to(0, 2));
  const auto mask = pairs.view_mask();
  ASSERT_TRUE(mask.defined());
  EXPECT_TRUE(torch::equal(mask, mask.t()));
  EXPECT_NEAR(mask.to(torch::kFloat64).mean().item<double>(), pairs.visibility.kept(), 1e-12);
  EXPECT_FALSE(mask[0][2].item<bool>());
}

TEST(VisiblePairs, CamerasAloneDecideWhereTheUnitIsNotKnown) {
  const Views views = rooms_in_a_row();
  const auto turned = visible_pairs(views, true_geometry(views, 0.5));
  EXPECT_FALSE(turned.visibility.used_depth);
  EXPECT_TRUE(turned.visibility.all());
  ASSERT_EQ(turned.warnings.size(), 1U);
  EXPECT_THAT(turned.warnings[0], testing::HasSubstr("cameras alone"));
  EXPECT_THAT(turned.warnings[0], testing::HasSubstr("but its fit leaves"));

  Views on_the_spot = views;
  for (Camera& camera : on_the_spot.cameras) camera.world_from_camera.translation().setZero();
  EXPECT_THAT(visible_pairs(on_the_spot, true_geometry(on_the_spot)).warnings,
              testing::Contains(testing::HasSubstr("nothing tells it")));

  auto no_rays = true_geometry(views);
  no_rays.rays.fill_(std::nan(""));
  EXPECT_EQ(visible_pairs(views, no_rays).warnings.size(), 1U);
  EXPECT_TRUE(visible_pairs(views, no_rays).visibility.all());
}

TEST(VisiblePairs, NoMaskWhereEveryPairAttends) {
  EXPECT_FALSE(visible_pairs(rooms_in_a_row()).view_mask().defined());
}

TEST(VisiblePairs, LonelyTargetsAreWarnedAbout) {
  Views views = rooms_in_a_row();
  views.cameras[4].world_from_camera.linear() =
      Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitY()).toRotationMatrix();
  views.cameras[4].world_from_camera.translation().z() = -3;
  const auto pairs = visible_pairs(views);
  ASSERT_EQ(pairs.warnings.size(), 1U);
  EXPECT_THAT(pairs.warnings[0], testing::HasSubstr("target view 4 looks at"));
  const auto json = view_pairs_json(pairs.visibility);
  EXPECT_EQ(json.at("attends").size(), 6U);
  EXPECT_EQ(json.at("targets_without_visible_source"), std::vector<int>({4}));
  EXPECT_DOUBLE_EQ(json.at("kept"), pairs.visibility.kept());
}

// The latents of both levels of a small random model, whose rays fit no camera: the cameras alone decide.
PipelineResult latents_of(const PipelineModels& models, const BundleOptions& bundle, const Views& views,
                          ViewPairs pairs) {
  PipelineRequest request;
  request.views = views;
  torch::manual_seed(4);
  request.source_images = torch::rand({views.num_sources, 3, kPicture.height, kPicture.width});
  const int64_t tokens = (kPicture.height / 14) * (kPicture.width / 14);
  for (const auto& part : bundle.generators) {
    request.noise.push_back(torch::randn({views.size(), tokens, part.dit.in_channels}));
    request.flow.solvers.emplace_back().evaluations = 3;
  }
  request.image_views = DecodedViews::kNone;
  request.flow.approximate.view_pairs = pairs;
  StageRecords stages;
  return run_pipeline(models, request, stages);
}

TEST(VisiblePairs, ThePipelineLeavesOutWhatIsApartAndNothingElse) {
  const test::TemporaryFolder folder;
  const auto options = small_bundle_options();
  write_random_bundle(folder.path(), options, 7);
  const auto models = bundle_models(ModelBundle::open(folder.path()), torch::kCPU);
  Views views = rooms_in_a_row();
  const auto together = latents_of(models, options, views, ViewPairs::kVisible);
  EXPECT_EQ(together.view_pairs->kept(), 1);
  const auto all = latents_of(models, options, views, ViewPairs::kAll);
  EXPECT_FALSE(all.view_pairs.has_value());
  EXPECT_TRUE(torch::equal(together.latents.at(1), all.latents.at(1)));
  EXPECT_TRUE(torch::equal(together.latents.at(0), all.latents.at(0)));

  // The first room's views turn around.
  for (const size_t view : {0, 3}) {
    views.cameras[view].world_from_camera.linear() =
        Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitY()).toRotationMatrix();
  }
  const auto apart = latents_of(models, options, views, ViewPairs::kVisible);
  EXPECT_LT(apart.view_pairs->kept(), 1);
  EXPECT_FALSE(apart.view_pairs->attends_to(0, 1));
  const auto exact = latents_of(models, options, views, ViewPairs::kAll);
  EXPECT_FALSE(torch::equal(apart.latents.at(1), exact.latents.at(1)));
  EXPECT_FALSE(torch::equal(apart.latents.at(0), exact.latents.at(0)));
}

}  // namespace
}  // namespace gld
