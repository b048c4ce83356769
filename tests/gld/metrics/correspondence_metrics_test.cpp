#include "gld/metrics/correspondence_metrics.h"

#include "gld/metrics/metric_list.h"
#include "tests/support/plane_room.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

// Returns a point's place on the wall, as features whose cosine falls with the distance: on a sphere far larger than
// the wall.
torch::Tensor world_features(const test::PlaneRoom& room) {
  std::vector<torch::Tensor> maps;
  for (const Camera& camera : room.cameras) {
    auto map = torch::empty({4, camera.height, camera.width}, torch::kFloat64);
    auto* value = map.data_ptr<double>();
    const int64_t pixels = camera.height * camera.width;
    for (int64_t pixel = 0; pixel < pixels; ++pixel) {
      const int64_t column = pixel % camera.width, row = pixel / camera.width;
      const Eigen::Vector3d p =
          room.point(camera, static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5);
      for (int64_t k = 0; k < 3; ++k) value[k * pixels + pixel] = p[k];
      value[3 * pixels + pixel] = 10;
    }
    maps.push_back(map);
  }
  return torch::stack(maps);
}

CorrespondenceView view_of(const test::PlaneRoom& room, const torch::Tensor& features, int64_t view) {
  return {features[view], room.depth_maps()[view], room.cameras[static_cast<size_t>(view)]};
}

TEST(Correspondence, IsPerfectForWorldCoordinates) {
  const test::PlaneRoom room(2, 160, 120);
  const auto features = world_features(room);
  const auto errors = correspondence_errors(view_of(room, features, 0), view_of(room, features, 1));
  EXPECT_EQ(errors.size(), 300U);  // a quarter of 40 x 30
  EXPECT_EQ(correct_keypoints(errors), 100);
  EXPECT_EQ(correct_keypoints(errors, 5), 100);
}

// Uniform guesses hit a disc of radius 10 of 160 x 120 with at most pi 100 / 19200 = 1.6 %.
TEST(Correspondence, IsChanceForRandomFeatures) {
  const test::PlaneRoom room(2, 320, 240);
  torch::manual_seed(4);
  const auto features = torch::randn({2, 16, 240, 320}, torch::kFloat64);
  const auto errors = correspondence_errors(view_of(room, features, 0), view_of(room, features, 1));
  EXPECT_EQ(errors.size(), 1000U);
  EXPECT_LT(correct_keypoints(errors), 1.7 + 1);
}

// Errors are in units of Probe3D's grid whatever the picture's size: features that show the wall a twentieth of the
// picture further right are off by 8 of 160, up to the cells of the grid.
TEST(Correspondence, ErrorsDoNotDependOnThePicturesSize) {
  for (const int64_t width : {160, 320}) {
    const test::PlaneRoom room(2, width, width * 3 / 4);
    test::PlaneRoom shifted = room;
    shifted.cameras[1].intrinsics(0, 2) += 0.05 * static_cast<double>(width);
    auto features = world_features(room);
    features[1] = world_features(shifted)[1];
    const auto errors = correspondence_errors(view_of(room, features, 0), view_of(room, features, 1));
    double mean = 0;
    for (const double error : errors) mean += error / static_cast<double>(errors.size());
    EXPECT_NEAR(mean, 8, 1.2) << width;
  }
}

TEST(Correspondence, APointBehindTheOtherCameraIsWrong) {
  test::PlaneRoom room(2, 40, 32);
  const auto features = world_features(room);
  const auto from = view_of(room, features, 0);
  auto to = view_of(room, features, 1);
  to.camera.world_from_camera.translation().z() += 100;
  const auto errors = correspondence_errors(from, to);
  ASSERT_FALSE(errors.empty());
  EXPECT_TRUE(std::isinf(errors.front()));
  EXPECT_EQ(correct_keypoints(errors), 0);
  EXPECT_TRUE(std::isnan(correct_keypoints({})));
}

TEST(PckMetrics, SayWhichLevelIsMissing) {
  const test::PlaneRoom room(3, 80, 60);
  MetricInputs inputs;
  inputs.views.cameras = room.cameras;
  inputs.views.num_sources = 1;
  inputs.all_true_depth = room.depth_maps();
  inputs.true_levels = {world_features(room)};
  EXPECT_EQ(measure(metric_named("pck_level0"), inputs).mean(), 100);
  EXPECT_EQ(measure(metric_named("pck_level1"), inputs).absent, "the backbone has no level 1");
  inputs.all_true_depth = torch::zeros_like(inputs.all_true_depth);
  EXPECT_EQ(measure(metric_named("pck_level0"), inputs).absent,
            "no pair of views has points with known depth");
}

}  // namespace
}  // namespace gld
