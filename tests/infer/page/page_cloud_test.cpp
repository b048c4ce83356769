#include "infer/page/page_cloud.h"

#include "tests/infer/page/unpacked_planes.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

Camera camera_at(double z) {
  Camera camera;
  camera.width = 40;
  camera.height = 20;
  camera.intrinsics << 30, 0, 18, 0, 25, 11, 0, 0, 1;
  camera.world_from_camera.translation() = Eigen::Vector3d(1e6, 0, z);
  return camera;
}

// Returns what the camera sees of the plane z = 5 of the world.
PointCloud plane_cloud() {
  PointView view;
  view.camera = camera_at(1);
  view.image = Image(40, 20);
  view.depth = DepthMap(40, 20);
  for (size_t i = 0; i < view.depth.metres.size(); ++i) {
    view.depth.metres[i] = 4;
    for (size_t c = 0; c < 3; ++c) view.image.rgb[3 * i + c] = static_cast<uint8_t>(37 * i + 11 * c);
  }
  PointCloudOptions all;
  all.confidence_quantile = 0;
  PointCloud cloud = build_point_cloud({view}, 1, all);
  for (size_t i = 0; i < cloud.confidences.size(); ++i) cloud.confidences[i] = static_cast<float>(i);
  return cloud;
}

struct Unpacked {
  std::vector<Eigen::Vector3d> points;
  std::vector<Rgb> colours;
  std::vector<double> footprints;
  std::vector<int> ranks;

  explicit Unpacked(const nlohmann::ordered_json& json) {
    const auto count = json.at("count").get<size_t>();
    test::UnpackedPlanes planes(json, 11);
    points = planes.points();
    colours.resize(count);
    for (size_t c = 0; c < 3; ++c) {
      const auto values = planes.plane();
      for (size_t i = 0; i < count; ++i) colours[i][c] = values[i];
    }
    for (const uint8_t steps : planes.plane())
      footprints.push_back(json.at("footprint").get<double>() * std::exp2(steps / 16.0));
    for (const uint8_t rank : planes.plane()) ranks.push_back(rank);
  }
};

TEST(PageCloud, IsTheCloudToSixteenBitsOfItsBoxAlsoFarFromTheOrigin) {
  const PointCloud cloud = plane_cloud();
  const Eigen::Vector3d origin(1e6, 2, 3);
  const auto json = page_cloud(cloud, {{camera_at(1), DepthMap()}}, origin, 1000);
  const Unpacked unpacked(json);
  ASSERT_EQ(unpacked.points.size(), 800u);
  EXPECT_EQ(json.at("of"), 800);
  EXPECT_EQ(unpacked.colours, cloud.colours);
  // The box is 40 / 30 * 4 wide: half a step, and the rounding of coordinates of 1e6.
  const double half_step = 40.0 / 30 * 4 / 131070;
  for (size_t i = 0; i < cloud.x_in_world.size(); ++i) {
    EXPECT_LT((unpacked.points[i] + origin - cloud.x_in_world[i]).cwiseAbs().maxCoeff(), half_step + 1e-9);
  }
  EXPECT_EQ(unpacked.ranks.front(), 0);
  EXPECT_EQ(unpacked.ranks.back(), 255);
  EXPECT_NEAR(unpacked.ranks[400], 127, 1);
}

TEST(PageCloud, AFootprintIsThePixelOfTheNearestCameraThatSeesThePoint) {
  const PointCloud cloud = plane_cloud();
  SeenDepth near{camera_at(3), DepthMap(40, 20)}, far{camera_at(1), DepthMap(40, 20)};
  for (float& depth : near.depth.metres) depth = 2;
  for (float& depth : far.depth.metres) depth = 4;
  // Rows are farther apart than columns: 4 / 25 and 2 / 25 of the plane. This holds to 2^(1/32).
  const auto at_middle = [&](const std::vector<SeenDepth>& views) {
    return Unpacked(page_cloud(cloud, views, Eigen::Vector3d::Zero(), 1000)).footprints[10 * 40 + 20];
  };
  EXPECT_NEAR(at_middle({far}) / (4.0 / 25), 1, 0.023);
  EXPECT_NEAR(at_middle({far, near}) / (2.0 / 25), 1, 0.023);
  // Behind something else, the near camera sees nothing of it.
  for (float& depth : near.depth.metres) depth = 1;
  EXPECT_NEAR(at_middle({far, near}) / (4.0 / 25), 1, 0.023);
}

TEST(PageCloud, IsThinnedToWhatIsAskedForAndFootprintsGrowWithIt) {
  const PointCloud cloud = plane_cloud();
  const std::vector<SeenDepth> views{{camera_at(1), DepthMap()}};
  const auto json = page_cloud(cloud, views, Eigen::Vector3d::Zero(), 100);
  EXPECT_LE(json.at("count").get<int>(), 100);
  EXPECT_GT(json.at("count").get<int>(), 40);
  EXPECT_EQ(json.at("of"), 800);
  EXPECT_GT(Unpacked(json).footprints[20], 2 * 4.0 / 25);
  EXPECT_EQ(page_cloud(cloud, views, Eigen::Vector3d::Zero(), 0).dump(), "{\"count\":0,\"of\":800}");
  EXPECT_EQ(page_cloud(PointCloud(), views, Eigen::Vector3d::Zero(), 100).dump(), "{\"count\":0,\"of\":0}");
}

TEST(PageCloud, OnePointHasABoxWithoutSize) {
  PointCloud cloud;
  cloud.x_in_world = {Eigen::Vector3d(1, 2, 3)};
  cloud.colours = {Rgb{1, 2, 3}};
  cloud.confidences = {1};
  const Unpacked unpacked(page_cloud(cloud, {}, Eigen::Vector3d::Zero(), 10));
  EXPECT_EQ(unpacked.points[0], cloud.x_in_world[0]);
  EXPECT_EQ(unpacked.ranks[0], 255);
}

TEST(PageCloud, PointsThatAreEquallySureAreAllAmongTheSurest) {
  PointCloud cloud = plane_cloud();
  std::fill(cloud.confidences.begin(), cloud.confidences.end(), 2.0F);
  cloud.confidences[7] = 1;
  const Unpacked unpacked(page_cloud(cloud, {}, Eigen::Vector3d::Zero(), 1000));
  // To hide the less sure half hides the one point that is less sure.
  EXPECT_EQ(
      std::count_if(unpacked.ranks.begin(), unpacked.ranks.end(), [](int rank) { return rank < 127.5; }), 1);
  EXPECT_EQ(unpacked.ranks[7], 0);
}

}  // namespace
}  // namespace gld
