#include "infer/export/point_cloud.h"

#include "gld/base/atomic_file.h"
#include "gld/photogrammetry/pose_from_rays.h"
#include "infer/export/ply_file.h"
#include "tests/support/error_of.h"
#include "tests/support/not_finite.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::kInfinity;
using test::kNan;

PointCloudOptions keep_all() {
  PointCloudOptions options;
  options.confidence_quantile = 0;
  options.far_limit = 0;
  options.edge_step = 1e6;
  return options;
}

Camera camera_of(int64_t width, int64_t height) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.intrinsics << 80, 0, 33, 0, 90, 17, 0, 0, 1;
  camera.world_from_camera.linear() =
      (Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(-0.2, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  camera.world_from_camera.translation() = Eigen::Vector3d(3, -2, 5);
  return camera;
}

// Returns a view of the plane normal . x = distance in the world, each pixel's colour telling where it is.
PointView plane_view(const Camera& camera, const Eigen::Vector3d& normal, double distance) {
  PointView view;
  view.camera = camera;
  view.image = Image(camera.width, camera.height);
  view.depth = DepthMap(camera.width, camera.height);
  const Eigen::Matrix3d inverse = camera.intrinsics.inverse();
  for (int64_t y = 0; y < camera.height; ++y) {
    for (int64_t x = 0; x < camera.width; ++x) {
      const Eigen::Vector3d direction =
          camera.world_from_camera.linear() *
          (inverse * Eigen::Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1));
      const double depth =
          (distance - normal.dot(camera.world_from_camera.translation())) / normal.dot(direction);
      view.depth.at(x, y) = static_cast<float>(depth);
      view.image.pixel(x, y)[0] = static_cast<uint8_t>(x);
      view.image.pixel(x, y)[1] = static_cast<uint8_t>(y);
    }
  }
  return view;
}

TEST(PointCloud, LiftsPixelsOntoTheSurface) {
  const Camera camera = camera_of(64, 36);
  const Eigen::Vector3d normal =
      (camera.world_from_camera.linear() * Eigen::Vector3d(0.3, -0.2, 1)).normalized();
  const double distance = normal.dot(camera.world_from_camera * Eigen::Vector3d(0, 0, 4));
  PointCloudOptions options = keep_all();
  options.edge_step = 1e-3;  // a slanted plane has no edges
  const PointCloud cloud = build_point_cloud({plane_view(camera, normal, distance)}, 1, options);
  ASSERT_EQ(cloud.size(), 64 * 36);
  for (size_t i = 0; i < cloud.x_in_world.size(); ++i) {
    EXPECT_NEAR(normal.dot(cloud.x_in_world[i]), distance, 3e-6);
    // Projected back, the point falls on the pixel whose colour it has.
    const Eigen::Vector3d pixel = camera.intrinsics * (camera.camera_from_world() * cloud.x_in_world[i]);
    EXPECT_NEAR(pixel[0] / pixel[2], cloud.colours[i][0] + 0.5, 1e-6);
    EXPECT_NEAR(pixel[1] / pixel[2], cloud.colours[i][1] + 0.5, 1e-6);
  }
}

TEST(PointCloud, DepthScaleAndCoarseDepthKeepTheGeometry) {
  Camera camera = camera_of(64, 36);
  PointView view =
      plane_view(camera, camera.world_from_camera.linear().col(2),
                 camera.world_from_camera.linear().col(2).dot(camera.world_from_camera.translation()) + 4);
  // Half the resolution and depth in a unit of 0.5.
  view.depth = DepthMap(32, 18);
  for (float& depth : view.depth.metres) depth = 8;
  const PointCloud cloud = build_point_cloud({view}, 0.5, keep_all());
  ASSERT_EQ(cloud.size(), 32 * 18);
  const Eigen::Vector3d first = camera.camera_from_world() * cloud.x_in_world[0];
  EXPECT_NEAR(first[2], 4, 1e-12);
  EXPECT_NEAR(80 * first[0] / first[2] + 33, 1, 1e-10);  // the middle of a cell of 2x2 pixels
  EXPECT_NEAR(90 * first[1] / first[2] + 17, 1, 1e-10);
  EXPECT_EQ(cloud.colours[0], (Rgb{1, 1, 0}));
}

// Rays linear in the pixel, as a camera's are, give the camera's points, also beyond the middles of the outermost
// cells.
TEST(PointCloud, RaysLiftLikeTheCameraTheyBelongTo) {
  const Camera camera = camera_of(63, 35);
  const Eigen::Vector3d normal =
      (camera.world_from_camera.linear() * Eigen::Vector3d(0.3, -0.2, 1)).normalized();
  const double distance = normal.dot(camera.world_from_camera * Eigen::Vector3d(0, 0, 4));
  PointView view = plane_view(camera, normal, distance);
  view.rays = rays_of_camera(camera, 36, 20);
  PointCloudOptions options = keep_all();
  const PointCloud by_camera = build_point_cloud({view}, 1, options);
  options.lifting = PointLifting::kRays;
  view.camera.world_from_camera.setIdentity();  // takes no part
  PointCloud by_rays = build_point_cloud({view}, 1, options);
  ASSERT_EQ(by_rays.size(), by_camera.size());
  for (size_t i = 0; i < by_rays.x_in_world.size(); ++i) {
    EXPECT_LT((by_rays.x_in_world[i] - by_camera.x_in_world[i]).norm(), 1e-5);
  }
  // A similarity moves what the rays say as a whole.
  view.world_from_rays.scale = 2;
  view.world_from_rays.translation = {0, 0, 100};
  const PointCloud moved = build_point_cloud({view}, 1, options);
  EXPECT_LT((moved.x_in_world[9] - (2 * by_rays.x_in_world[9] + Eigen::Vector3d(0, 0, 100))).norm(), 1e-9);
  // A map of one cell is the same ray everywhere.
  view.rays = RayMap(1, 1);
  view.rays.values = {0, 0, 1, 5, 6, 7};
  view.world_from_rays = {};
  for (const Eigen::Vector3d& point : build_point_cloud({view}, 1, options).x_in_world) {
    EXPECT_EQ(point.head<2>(), Eigen::Vector2d(5, 6));
  }
}

// A predicted point is the pixel's, whatever the camera and the depth say; depth still leaves pixels out.
TEST(PointCloud, PointMapsAreTakenAsTheyAre) {
  PointView view;
  view.camera = camera_of(4, 3);
  view.image = Image(4, 3);
  view.depth = DepthMap(4, 3);
  std::fill(view.depth.metres.begin(), view.depth.metres.end(), 2.0F);
  PointCloudOptions options = keep_all();
  options.lifting = PointLifting::kPointMaps;
  EXPECT_EQ(
      test::error_of([&] { build_point_cloud({view}, 1, options); }),
      "point cloud, view 0: expected a point map of the depth's size 4x3, found none; take a model whose head "
      "predicts points, or another points.lifting.");
  view.points = PointMap(3, 4);
  EXPECT_EQ(
      test::error_of([&] { build_point_cloud({view}, 1, options); }),
      "point cloud, view 0: expected a point map of the depth's size 4x3, found 3x4; take a model whose head "
      "predicts points, or another points.lifting.");
  view.points = PointMap(4, 3);
  for (int64_t y = 0; y < 3; ++y) {
    for (int64_t x = 0; x < 4; ++x) {
      float* point = view.points.point(x, y);
      point[0] = static_cast<float>(x);
      point[1] = static_cast<float>(y);
      point[2] = 7;
    }
  }
  view.points.point(2, 1)[2] = kNan;
  view.depth.at(0, 0) = 0;  // unknown
  view.world_from_rays.scale = 2;
  view.world_from_rays.translation = {0, 0, 100};
  const PointCloud cloud = build_point_cloud({view}, 1, options);
  EXPECT_EQ(cloud.counts.unknown_depth, 2);
  ASSERT_EQ(cloud.size(), 10);
  EXPECT_EQ(cloud.x_in_world.front(), Eigen::Vector3d(2, 0, 114));
  EXPECT_EQ(cloud.x_in_world.back(), Eigen::Vector3d(6, 4, 114));
}

TEST(PointCloud, RaysThatAreNotFiniteAreUnknown) {
  PointView view;
  view.camera = camera_of(8, 8);
  view.image = Image(8, 8);
  view.depth = DepthMap(8, 8);
  std::fill(view.depth.metres.begin(), view.depth.metres.end(), 2.0F);
  PointCloudOptions options = keep_all();
  options.lifting = PointLifting::kRays;
  EXPECT_EQ(
      test::error_of([&] { build_point_cloud({view}, 1, options); }),
      "point cloud, view 0: expected a ray map to lift the depth with, found none; predict rays as well.");
  view.rays = rays_of_camera(view.camera, 4, 4);
  view.rays.ray(0, 0)[1] = kNan;
  view.rays.ray(3, 3)[4] = kInfinity;
  const PointCloud cloud = build_point_cloud({view}, 1, options);
  EXPECT_GT(cloud.counts.unknown_depth, 0);
  EXPECT_EQ(cloud.size() + cloud.counts.unknown_depth, 64);
  for (const Eigen::Vector3d& point : cloud.x_in_world) EXPECT_TRUE(point.allFinite());
}

TEST(PointCloud, LeavesOutUnsureUnknownEdgesAndFar) {
  PointView view;
  view.camera = camera_of(10, 10);
  view.image = Image(10, 10);
  view.depth = DepthMap(10, 10);
  view.confidence = ConfidenceMap(10, 10);
  for (int64_t y = 0; y < 10; ++y) {
    for (int64_t x = 0; x < 10; ++x) {
      view.depth.at(x, y) = x < 5 ? 2.0F : 6.0F;  // an edge between columns 4 and 5
      view.confidence.at(x, y) = static_cast<float>(1 + y);
    }
  }
  view.depth.at(0, 9) = kNan;
  view.depth.at(1, 9) = 0;
  view.depth.at(9, 9) = 3e38F;
  view.confidence.at(8, 9) = kInfinity;
  view.confidence.at(7, 9) = 0;
  PointCloudOptions options;
  options.confidence_quantile = 0.5;
  const PointCloud cloud = build_point_cloud({view}, 1, options);
  EXPECT_EQ(cloud.counts.pixels, 100);
  EXPECT_EQ(cloud.counts.unknown_depth, 4);
  EXPECT_EQ(cloud.counts.low_confidence, 40);      // the median of the 96 is the fifth row's 5
  EXPECT_EQ(cloud.counts.depth_edges, 2 * 6 + 1);  // both sides of the step, and beside the overflow above it
  EXPECT_EQ(cloud.counts.too_far, 1);
  EXPECT_EQ(cloud.size() + 4 + 40 + cloud.counts.depth_edges + cloud.counts.too_far, 100);
  for (const float confidence : cloud.confidences) EXPECT_GE(confidence, 5);
}

TEST(PointCloud, EveryQuantileOfEqualConfidencesKeepsThemAll) {
  PointView flat;
  flat.camera = camera_of(8, 64);
  flat.image = Image(8, 64);
  flat.depth = DepthMap(8, 64);
  flat.confidence = ConfidenceMap(8, 64);
  std::fill(flat.depth.metres.begin(), flat.depth.metres.end(), 2.0F);
  std::fill(flat.confidence.values.begin(), flat.confidence.values.end(), 1.0F);
  PointCloudOptions options;
  options.confidence_quantile = 1;
  EXPECT_EQ(build_point_cloud({flat}, 1, options).size(), 8 * 64);
  EXPECT_EQ(build_point_cloud({}, 1, {}).size(), 0);
}

TEST(PointCloud, ThinsToTheLimitAndKeepsTheSurest) {
  const Camera camera = camera_of(64, 36);
  PointView view =
      plane_view(camera, camera.world_from_camera.linear().col(2),
                 camera.world_from_camera.linear().col(2).dot(camera.world_from_camera.translation()) + 4);
  view.confidence = ConfidenceMap(64, 36);
  std::fill(view.confidence.values.begin(), view.confidence.values.end(), 1.0F);
  view.confidence.at(40, 20) = 9;
  PointCloudOptions options = keep_all();
  options.max_points = 500;
  const PointCloud cloud = build_point_cloud({view}, 1, options);
  EXPECT_LE(cloud.size(), 500);
  EXPECT_GT(cloud.size(), 250);
  EXPECT_EQ(cloud.counts.thinned, 64 * 36 - cloud.size());
  EXPECT_EQ(std::count(cloud.confidences.begin(), cloud.confidences.end(), 9.0F), 1);
  // What is left covers the whole surface: every quarter of the picture keeps its share.
  std::map<std::pair<bool, bool>, int> quarters;
  for (const Rgb& colour : cloud.colours) ++quarters[{colour[0] < 32, colour[1] < 18}];
  ASSERT_EQ(quarters.size(), 4U);
  for (const auto& [quarter, count] : quarters) EXPECT_GT(count, static_cast<int>(cloud.size() / 6));
  options.max_points = 1;
  EXPECT_EQ(build_point_cloud({view}, 1, options).size(), 1);
}

TEST(PointCloud, ThinsPointsThatAllCoincide) {
  PointCloud cloud;
  for (int i = 0; i < 10; ++i) {
    cloud.x_in_world.emplace_back(1, 2, 3);
    cloud.colours.push_back({0, 0, 0});
    cloud.confidences.push_back(static_cast<float>(i));
  }
  thin_point_cloud(cloud, 4);
  EXPECT_THAT(cloud.confidences, testing::ElementsAre(9));
}

TEST(PointCloud, RefusesViewsThatDoNotFit) {
  PointView view;
  view.camera = camera_of(4, 4);
  view.depth = DepthMap(4, 4);
  EXPECT_EQ(
      test::error_of([&] { build_point_cloud({view}, 1, {}); }),
      "point cloud, view 0: expected an image to colour the points, found none; decode the image as well.");
  view.image = Image(4, 4);
  view.confidence = ConfidenceMap(2, 4);
  EXPECT_EQ(
      test::error_of([&] { build_point_cloud({view}, 1, {}); }),
      "point cloud, view 0: expected confidences of the depth's size 4x4, found 2x4; check what made them.");
  EXPECT_EQ(test::error_of([&] { build_point_cloud({}, -2, {}); }),
            "point cloud: expected a positive depth scale, found -2.000000; check the cameras.");
}

PointCloud three_points(const Eigen::Vector3d& offset) {
  PointCloud cloud;
  cloud.x_in_world = {offset + Eigen::Vector3d(0.1, 0.2, 0.3), offset + Eigen::Vector3d(-1, 0, 2),
                      offset + Eigen::Vector3d(1, 1, 1)};
  cloud.colours = {{255, 0, 10}, {1, 2, 3}, {0, 0, 0}};
  cloud.confidences = {1, 2.5F, 3};
  return cloud;
}

TEST(PlyFile, KeepsPointsAndProvenance) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "points.ply";
  Provenance provenance;
  provenance.program = "gld test";
  provenance.options = "{\"long\":\"" + std::string(2000, 'x') + "\"}";
  provenance.seed = 11;
  export_ply(file, three_points({0, 0, 0}), provenance);
  const PlyFile read = read_ply(file);
  EXPECT_FALSE(read.doubles);
  ASSERT_EQ(read.cloud.size(), 3);
  EXPECT_EQ(read.cloud.x_in_world[0], Eigen::Vector3d(0.1F, 0.2F, 0.3F));
  EXPECT_EQ(read.cloud.colours[0], (Rgb{255, 0, 10}));
  EXPECT_THAT(read.cloud.confidences, testing::ElementsAre(1, 2.5F, 3));
  EXPECT_EQ(read.comments, provenance_items(provenance));
  const std::string bytes = read_file(file);
  EXPECT_EQ(bytes.substr(0, 36), "ply\nformat binary_little_endian 1.0\n");
  size_t line_start = 0;
  const size_t header_end = bytes.find("end_header\n");
  while (line_start < header_end) {
    const size_t line_end = bytes.find('\n', line_start);
    EXPECT_LT(line_end - line_start, 1000U);
    line_start = line_end + 1;
  }
  export_ply(folder.path() / "again.ply", three_points({0, 0, 0}), provenance);
  EXPECT_EQ(read_file(folder.path() / "again.ply"), bytes);
}

TEST(PlyFile, KeepsTheDigitsOfAFarScene) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "points.ply";
  const PointCloud cloud = three_points({1e6, -1e6, 0});
  export_ply(file, cloud, {});
  const PlyFile read = read_ply(file);
  EXPECT_TRUE(read.doubles);
  EXPECT_EQ(read.cloud.x_in_world, cloud.x_in_world);
}

TEST(PlyFile, WritesAnEmptyCloud) {
  test::TemporaryFolder folder;
  export_ply(folder.path() / "points.ply", PointCloud(), {});
  EXPECT_EQ(read_ply(folder.path() / "points.ply").cloud.size(), 0);
  EXPECT_THAT(read_file(folder.path() / "points.ply"), testing::HasSubstr("element vertex 0\n"));
}

TEST(PlyFile, RefusesPointsThatAreNotFiniteAndOtherFiles) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "points.ply";
  PointCloud cloud = three_points({0, 0, 0});
  cloud.x_in_world[1][2] = kNan;
  EXPECT_EQ(
      test::error_of([&] { export_ply(file, cloud, {}); }),
      file.string() +
          ": expected finite points, found one that is not, number 1; check the depth and the cameras.");
  EXPECT_FALSE(std::filesystem::exists(file));
  export_ply(file, three_points({0, 0, 0}), {});
  const std::string bytes = read_file(file);
  write_file_atomically(file, bytes.substr(0, bytes.size() - 1));
  EXPECT_EQ(test::error_of([&] { read_ply(file); }),
            file.string() + ": expected 3 vertices of 19 bytes, found 56 bytes; write it again.");
  write_file_atomically(file, "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n");
  EXPECT_EQ(test::error_of([&] { read_ply(file); }),
            file.string() +
                ": expected a point cloud of this program, found another PLY header; "
                "open it with another program.");
  write_file_atomically(file, "obj");
  EXPECT_EQ(test::error_of([&] { read_ply(file); }),
            file.string() + ": expected a PLY file, found another one; check the path.");
}

}  // namespace
}  // namespace gld
