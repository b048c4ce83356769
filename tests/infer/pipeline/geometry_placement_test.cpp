#include "models/scene_geometry/geometry_placement.h"

#include "gld/photogrammetry/pose_from_rays.h"
#include "infer/pipeline/placed_cloud.h"
#include "infer/request/scale_evidence.h"
#include "models/scene_geometry/predicted_cameras.h"
#include "tests/support/error_of.h"
#include "tests/support/textured_plane.h"

#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;

constexpr int64_t kWidth = 56;
constexpr int64_t kHeight = 28;
const Vector3d kNormal = Vector3d(0.2, -0.3, 1).normalized();
constexpr double kDistance = 5;  // of the plane kNormal . x = kDistance in the model's frame

// The camera is as cropping leaves it: the principal point is far from the middle.
Camera camera_at(const Vector3d& centre, double turn) {
  Camera camera;
  camera.width = kWidth;
  camera.height = kHeight;
  camera.intrinsics << 50, 0, 39, 0, 50, 8, 0, 0, 1;
  camera.world_from_camera.linear() = Eigen::AngleAxisd(turn, Vector3d::UnitY()).toRotationMatrix();
  camera.world_from_camera.translation() = centre;
  return camera;
}

std::vector<Camera> model_cameras() {
  return {camera_at({0, 0, 0}, 0), camera_at({0.8, 0.1, -0.2}, -0.15), camera_at({-0.7, 0.2, 0.3}, 0.2)};
}

// Returns what a model predicts that sees the plane from these cameras.
GeometryOutput plane_seen_from(const std::vector<Camera>& cameras) {
  GeometryOutput geometry;
  std::vector<torch::Tensor> rays, depths;
  for (const Camera& camera : cameras) {
    const RayMap map = rays_of_camera(camera, 32, 16);
    rays.push_back(torch::tensor(map.values).view({16, 32, 6}));
    const RayMap fine = rays_of_camera(camera, kWidth, kHeight);
    DepthMap depth(kWidth, kHeight);
    for (int64_t y = 0; y < kHeight; ++y) {
      for (int64_t x = 0; x < kWidth; ++x) {
        const Vector3d direction = Eigen::Map<const Eigen::Vector3f>(fine.ray(x, y)).cast<double>();
        const Vector3d& centre = camera.world_from_camera.translation();
        depth.at(x, y) = static_cast<float>((kDistance - kNormal.dot(centre)) / kNormal.dot(direction));
      }
    }
    depths.push_back(torch::tensor(depth.metres).view({kHeight, kWidth}));
  }
  geometry.rays = torch::stack(rays);
  geometry.depth = torch::stack(depths);
  geometry.ray_confidence = torch::full({geometry.rays.size(0), 16, 32}, 2.0F);
  geometry.depth_confidence = torch::full_like(geometry.depth, 2.0F);
  return geometry;
}

// The world of the scene: turned, moved, and 3 of its units to one of the model's.
std::vector<Camera> scene_cameras() {
  std::vector<Camera> cameras = model_cameras();
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(1.1, Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  for (Camera& camera : cameras) {
    const Vector3d centre = camera.world_from_camera.translation();
    camera.world_from_camera.linear() = turn * camera.world_from_camera.linear();
    camera.world_from_camera.translation() = 3 * (turn * centre) + Vector3d(10, 20, 30);
  }
  return cameras;
}

PointCloudOptions keep_all(PointLifting lifting) {
  PointCloudOptions options;
  options.lifting = lifting;
  options.confidence_quantile = 0;
  return options;
}

// Returns the root mean square distance of the points from the plane that fits them best.
double off_plane(const PointCloud& cloud) {
  Vector3d mean = Vector3d::Zero();
  const auto count = static_cast<double>(cloud.size());
  for (const Vector3d& point : cloud.x_in_world) mean += point / count;
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (const Vector3d& point : cloud.x_in_world)
    spread += (point - mean) * (point - mean).transpose() / count;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(spread);
  return std::sqrt(std::max(0.0, solver.eigenvalues()[0]));
}

const std::vector<Image> kImages(3, Image(kWidth, kHeight));

TEST(GeometryPlacement, PredictedCamerasKeepThePrincipalPointsThatCroppingLeft) {
  const auto truth = model_cameras();
  const auto found = predicted_cameras(plane_seen_from(truth), scene_cameras());
  ASSERT_EQ(found.size(), 3U);
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_LT((found[i].intrinsics - truth[i].intrinsics).norm(), 1e-3);
    EXPECT_LT(rotation_angle(found[i].world_from_camera.linear(), truth[i].world_from_camera.linear()), 1e-3);
  }
  EXPECT_EQ(test::error_of([&] { predicted_cameras(plane_seen_from(truth), {truth[0]}); }),
            "predicted cameras: expected one given camera for each of 3 ray maps, found 1; check the views.");
}

TEST(GeometryPlacement, AKnownScaleBringsThePlaneIntoTheScene) {
  const auto given = scene_cameras();
  const auto geometry = plane_seen_from(model_cameras());
  const auto placement = place_geometry(geometry, given);
  ASSERT_TRUE(placement.scale.has_value());
  EXPECT_NEAR(placement.scale->scale, 3, 1e-3);
  const auto by_camera =
      point_cloud_of({geometry, placement}, given, kImages, keep_all(PointLifting::kCameras));
  const auto by_rays = point_cloud_of({geometry, placement}, given, kImages, keep_all(PointLifting::kRays));
  EXPECT_EQ(by_camera.size(), 3 * kWidth * kHeight);
  EXPECT_LT(off_plane(by_camera), 0.01);
  EXPECT_LT(off_plane(by_rays), 0.01);
  ASSERT_EQ(by_rays.size(), by_camera.size());
  for (size_t i = 0; i < by_rays.x_in_world.size(); ++i) {
    EXPECT_LT((by_rays.x_in_world[i] - by_camera.x_in_world[i]).norm(), 0.02);
  }
}

// Points predicted in the frame of the rays come to where depth and rays put them, with their own confidence.
TEST(GeometryPlacement, PointMapsComeToTheSamePlane) {
  const auto given = scene_cameras();
  auto geometry = plane_seen_from(model_cameras());
  const auto placement = place_geometry(geometry, given);
  std::vector<torch::Tensor> points;
  const auto cameras = model_cameras();
  for (size_t view = 0; view < cameras.size(); ++view) {
    const auto depth = geometry.depth[static_cast<int64_t>(view)].contiguous();
    auto map = torch::empty({depth.size(0), depth.size(1), 3});
    for (int64_t y = 0; y < depth.size(0); ++y) {
      for (int64_t x = 0; x < depth.size(1); ++x) {
        const double z = depth[y][x].item<double>();
        const Eigen::Matrix3d& k = cameras[view].intrinsics;
        const Vector3d point = cameras[view].world_from_camera *
                               Vector3d((static_cast<double>(x) + 0.5 - k(0, 2)) / k(0, 0) * z,
                                        (static_cast<double>(y) + 0.5 - k(1, 2)) / k(1, 1) * z, z);
        for (int axis = 0; axis < 3; ++axis) map[y][x][axis] = point[axis];
      }
    }
    points.push_back(map);
  }
  geometry.points = torch::stack(points);
  geometry.point_confidence = torch::full_like(geometry.depth, 3.0F);
  const auto by_points =
      point_cloud_of({geometry, placement}, given, kImages, keep_all(PointLifting::kPointMaps));
  const auto by_camera =
      point_cloud_of({geometry, placement}, given, kImages, keep_all(PointLifting::kCameras));
  ASSERT_EQ(by_points.size(), by_camera.size());
  for (size_t i = 0; i < by_points.x_in_world.size(); ++i) {
    EXPECT_LT((by_points.x_in_world[i] - by_camera.x_in_world[i]).norm(), 0.02);
    EXPECT_EQ(by_points.confidences[i], 3.0F);
  }
  EXPECT_EQ(lifting_of({GeometryOutput(), GeometryPlacement()}, keep_all(PointLifting::kPointMaps)),
            PointLifting::kPointMaps);
}

// A scene taken from one place does not tell the scale; the model's own cameras make its views line up.
TEST(GeometryPlacement, WithoutAScaleTheViewsStillLineUp) {
  auto given = scene_cameras();
  for (Camera& camera : given) camera.world_from_camera.translation() = Vector3d(10, 20, 30);
  const auto geometry = plane_seen_from(model_cameras());
  const auto placement = place_geometry(geometry, given);
  ASSERT_EQ(placement.predicted.size(), 3U);
  EXPECT_FALSE(placement.scale.has_value());
  for (const PointLifting lifting : {PointLifting::kCameras, PointLifting::kRays}) {
    const auto cloud = point_cloud_of({geometry, placement}, given, kImages, keep_all(lifting));
    EXPECT_EQ(cloud.size(), 3 * kWidth * kHeight);
    EXPECT_LT(off_plane(cloud), 0.01);
  }
  // In the scene's orientation and place.
  const auto cameras = cameras_of_depth(placement, given);
  Vector3d middle = Vector3d::Zero();
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_LT(rotation_angle(cameras[i].world_from_camera.linear(), given[i].world_from_camera.linear()),
              1e-2);
    middle += cameras[i].world_from_camera.translation() / 3;
  }
  EXPECT_LT((middle - Vector3d(10, 20, 30)).norm(), 1e-9);
  EXPECT_NEAR(
      (cameras[0].world_from_camera.translation() - cameras[1].world_from_camera.translation()).norm(),
      Vector3d(0.8, 0.1, -0.2).norm(), 1e-3);
}

// The shipped model's rays say nothing of where cameras stand. The photographs do.
TEST(GeometryPlacement, PhotographsTellTheScaleWhereRaysDoNot) {
  const test::TexturedPlane plane;
  std::vector<Camera> given;
  GeometryOutput geometry;
  std::vector<torch::Tensor> depths, pictures, rays;
  for (const double x : {0.0, 0.7, 0.4}) {
    given.push_back(test::camera_before_plane({x, 0.1 * x, 0}, -0.2 * x));
    const PicturedView view = plane.seen_by(given.back(), 2.5);
    depths.push_back(torch::tensor(view.depth.values).view({view.height, view.width}));
    pictures.push_back(torch::tensor(view.rgb).view({view.height, view.width, 3}).permute({2, 0, 1}));
    const RayMap map = rays_of_camera(given.back(), 32, 24);
    rays.push_back(torch::tensor(map.values).view({24, 32, 6}));
  }
  geometry.depth = torch::stack(depths);
  geometry.rays = torch::stack(rays);
  const auto origins = torch::tensor({0.F, 0.F, 0.F, 1.F, 3.F, -2.F, -1.F, -2.F, 3.F}).view({3, 1, 1, 3});
  geometry.rays.narrow(3, 3, 3).copy_(1e-4 * origins.expand({3, 24, 32, 3}));
  geometry.ray_confidence = torch::full({3, 24, 32}, 2.0F);
  geometry.depth_confidence = torch::full_like(geometry.depth, 2.0F);

  const auto by_rays = place_geometry(geometry, given);
  EXPECT_FALSE(by_rays.scale.has_value());
  EXPECT_THAT(estimates_text(by_rays.estimates), testing::HasSubstr("but its fit leaves"));

  ScaleEvidence evidence;
  evidence.photographs = torch::stack({pictures[0], pictures[1]});  // the third view was not photographed
  const auto placement = place_geometry(geometry, given, evidence);
  ASSERT_TRUE(placement.scale.has_value());
  EXPECT_EQ(placement.scale->estimator, "photographs");
  EXPECT_NEAR(placement.scale->scale, 2.5, 0.05);
  const auto listed = estimates_json(placement.estimates);
  ASSERT_EQ(listed.size(), 2U);
  EXPECT_TRUE(listed[0].contains("doubt"));
  EXPECT_FALSE(listed[1].contains("doubt"));

  // Even where no camera fits the rays.
  geometry.rays.fill_(std::numeric_limits<float>::quiet_NaN());
  const auto without_rays = place_geometry(geometry, given, evidence);
  ASSERT_TRUE(without_rays.scale.has_value());
  EXPECT_EQ(lifting_of({GeometryOutput(), without_rays}, PointCloudOptions()), PointLifting::kCameras);
  EXPECT_EQ(cameras_of_depth(without_rays, given).size(), 3U);
}

TEST(GeometryPlacement, WithoutCamerasTheRaysLift) {
  const auto given = scene_cameras();
  auto geometry = plane_seen_from(model_cameras());
  geometry.rays[1].fill_(std::numeric_limits<float>::quiet_NaN());
  const auto placement = place_geometry(geometry, given);
  EXPECT_TRUE(placement.predicted.empty());
  EXPECT_THAT(placement.problem, testing::HasSubstr("at least 16 finite rays"));
  EXPECT_EQ(lifting_of({GeometryOutput(), placement}, keep_all(PointLifting::kCameras)), PointLifting::kRays);
  const auto cloud = point_cloud_of({geometry, placement}, given, kImages, keep_all(PointLifting::kCameras));
  EXPECT_EQ(cloud.size(), 2 * kWidth * kHeight);
  EXPECT_EQ(cloud.counts.unknown_depth, kWidth * kHeight);
  EXPECT_LT(off_plane(cloud), 1e-3);
  for (const Vector3d& point : cloud.x_in_world) EXPECT_NEAR(kNormal.dot(point), kDistance, 1e-3);
}

TEST(GeometryPlacement, AnotherEstimatorsScaleKeepsTheMiddleOfTheCameras) {
  const auto given = scene_cameras();
  auto placement = place_geometry(plane_seen_from(model_cameras()), given);
  placement.scale->scale = 6;
  Vector3d in_model = Vector3d::Zero(), in_scene = Vector3d::Zero();
  for (size_t i = 0; i < 3; ++i) {
    in_model += placement.predicted[i].world_from_camera.translation() / 3;
    in_scene += given[i].world_from_camera.translation() / 3;
  }
  EXPECT_EQ(placement.scene_from_model().scale, 6);
  EXPECT_LT((placement.scene_from_model() * in_model - in_scene).norm(), 1e-9);
}

// Views that the model made of one photograph show how far it believes to have moved, and not how far that was.
TEST(ScaleEvidence, OnePhotographsCamerasTellNothing) {
  SamplingScene scene;
  scene.source_images = {Image(kWidth, kHeight)};
  EXPECT_FALSE(scale_evidence(scene, usual_scale_evidence()).camera_poses);
  EXPECT_TRUE(scale_evidence(scene, {"camera_poses"}).camera_poses);
  scene.source_images.emplace_back(kWidth, kHeight);
  EXPECT_TRUE(scale_evidence(scene, usual_scale_evidence()).camera_poses);
}

// By any choice of several kinds: the usual ones were others once, and stand in the settings of older runs.
TEST(ScaleEvidence, WhatWasSeenOfOnePhotographIsEvidence) {
  SamplingScene scene;
  scene.source_images = {Image(kWidth, kHeight)};
  scene.seen_depth = depth_of_scene({{kWidth, kHeight, std::vector<float>(kWidth * kHeight, 3.0F)}});
  EXPECT_EQ(scale_evidence(scene, usual_scale_evidence()).source_depth.size(), 1U);
  EXPECT_EQ(scale_evidence(scene, {"camera_poses", "photographs", "sparse_points"}).source_depth.size(), 1U);
  EXPECT_TRUE(scale_evidence(scene, {"camera_poses"}).source_depth.empty());
}

TEST(ScaleEvidence, AGuessedUnitIsOneWhereItsErrorIsKnown) {
  SamplingScene scene;
  scene.source_images = {Image(kWidth, kHeight)};
  PipelineResult found;
  found.head_depth = {{kWidth, kHeight, std::vector<float>(kWidth * kHeight, 3.0F)}};
  EXPECT_TRUE(scale_evidence(scene, usual_scale_evidence(), found).usual_unit_depth.empty());
  found.head_depth_log_deviation = 0.2;
  const ScaleEvidence evidence = scale_evidence(scene, usual_scale_evidence(), found);
  ASSERT_EQ(evidence.usual_unit_depth.size(), 1U);
  EXPECT_EQ(evidence.usual_unit_log_deviation, 0.2);
  EXPECT_TRUE(scale_evidence(scene, {"sparse_points"}, found).usual_unit_depth.empty());
}

// The depth of one view, told in another unit with an error of 20 %, gives a scale with an interval of two deviations.
TEST(GeometryPlacement, AGuessedUnitIsAsSureAsItsError) {
  const auto geometry = plane_seen_from(model_cameras());
  const auto first = geometry.depth[0].to(torch::kFloat32).contiguous();
  ScaleEvidence evidence;
  evidence.camera_poses = false;
  PlanarDepth told{first.size(1), first.size(0), {}};
  for (int64_t i = 0; i < first.numel(); ++i) told.values.push_back(3.5F * first.data_ptr<float>()[i]);
  evidence.usual_unit_depth = {told};
  evidence.usual_unit_log_deviation = 0.2;
  const auto placement = place_geometry(geometry, scene_cameras(), evidence);
  ASSERT_TRUE(placement.scale.has_value());
  EXPECT_EQ(placement.scale->estimator, "usual_unit");
  EXPECT_NEAR(placement.scale->scale, 3.5, 0.02);
  EXPECT_NEAR(std::log(placement.scale->high / placement.scale->scale), 0.4, 0.02);
  EXPECT_NEAR(std::log(placement.scale->scale / placement.scale->low), 0.4, 0.02);
}

TEST(PlacedCloud, LiesInTheWorldWhereItsUnitOrItsCamerasAreKnown) {
  const GeometryOutput geometry;
  GeometryPlacement placement;
  PointCloudOptions by_cameras, by_rays;
  by_cameras.lifting = PointLifting::kCameras;
  by_rays.lifting = PointLifting::kRays;
  EXPECT_FALSE(cloud_is_in_world({geometry, placement}, by_cameras));
  // Photographs tell depth in the unit of the given cameras, which lift it; rays are in a frame of their own.
  EXPECT_TRUE(cloud_is_in_world({geometry, placement, {PlanarDepth()}}, by_cameras));
  EXPECT_FALSE(cloud_is_in_world({geometry, placement, {PlanarDepth()}}, by_rays));
  placement.scale = DepthScale();
  EXPECT_TRUE(cloud_is_in_world({geometry, placement}, by_cameras));
  EXPECT_FALSE(cloud_is_in_world({geometry, placement}, by_rays));
  placement.alignment = PoseAlignment();
  EXPECT_TRUE(cloud_is_in_world({geometry, placement}, by_rays));
}

}  // namespace
}  // namespace gld
