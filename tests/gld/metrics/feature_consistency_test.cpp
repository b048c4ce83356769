#include "gld/metrics/feature_consistency.h"

#include "gld/metrics/feature_sampling.h"
#include "gld/metrics/metric_list.h"
#include "tests/support/error_of.h"
#include "tests/support/plane_room.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(FeaturesAt, AreBilinearBetweenTheMiddlesOfCells) {
  const auto map = torch::arange(6, torch::kFloat64).view({1, 2, 3});  // 0 1 2 / 3 4 5
  const auto places =
      torch::tensor({1 / 6.0, 0.25, 0.5, 0.5, 0.0, 0.0, 1.0, 1.0}, torch::kFloat64).view({4, 2});
  const auto found = features_at(map, places);
  EXPECT_TRUE(
      torch::allclose(found, torch::tensor({0.0, 2.5, 0.0, 5.0}, torch::kFloat64).view({4, 1}), 1e-12, 1e-12))
      << found;
}

FeatureView features_of(const test::PlaneRoom& room, const torch::Tensor& features, int64_t view) {
  return {features[view], room.depth_maps()[view], room.cameras[static_cast<size_t>(view)]};
}

TEST(FeatureConsistency, IsZeroForIdenticalImages) {
  const test::PlaneRoom room(1, 32, 24);
  const FeatureView view = features_of(room, torch::rand({1, 7, 6, 8}), 0);
  const FeatureConsistency found = feature_consistency(view, view);
  EXPECT_NEAR(found.distance, 0, 1e-6);
  EXPECT_NEAR(found.coverage, 1, 1e-12);
}

TEST(FeatureConsistency, IsOneMinusTheCosineOfConstantFeatures) {
  const test::PlaneRoom room(2, 32, 24);
  auto features = torch::zeros({2, 2, 3, 4});
  features[0][0] = 2;                // along the first channel
  features[1] = 1 / std::sqrt(2.0);  // between both
  EXPECT_NEAR(feature_consistency(features_of(room, features, 0), features_of(room, features, 1)).distance,
              1 - std::sqrt(0.5), 1e-6);
}

TEST(FeatureConsistency, GrowsWithTheErrorOfTheCamera) {
  const test::PlaneRoom room(2, 64, 48);
  const auto features = room.textures(6) - 0.5;
  double last = -1;
  for (int i = 0; i < 10; ++i) {
    FeatureView other = features_of(room, features, 1);
    other.camera.world_from_camera.translation() += 0.03 * i * Eigen::Vector3d(1, 0.3, 0);
    const double distance = feature_consistency(features_of(room, features, 0), other).distance;
    EXPECT_GT(distance, last) << i;
    last = distance;
  }
  EXPECT_GT(last, 0.02);
}

TEST(FeatureConsistency, SaysHowMuchItCovers) {
  const test::PlaneRoom room(2, 32, 24);
  FeatureView first = features_of(room, torch::rand({2, 5, 4, 4}), 0),
              other = features_of(room, torch::rand({2, 5, 4, 4}), 1);
  other.camera.world_from_camera.translation().x() += 1000;
  EXPECT_TRUE(std::isnan(feature_consistency(first, other).distance));
  EXPECT_EQ(feature_consistency(first, other).coverage, 0);
  first.depth = torch::zeros_like(first.depth);
  EXPECT_TRUE(std::isnan(feature_consistency(first, other).coverage));
  first.depth = torch::zeros({3, 3});
  EXPECT_THAT(test::error_of([&] { feature_consistency(first, other); }),
              testing::HasSubstr("resize the depth"));
}

TEST(ConsistencyMetrics, CompareEachTargetWithTheNearestView) {
  const test::PlaneRoom room(3, 32, 24);
  MetricInputs inputs;
  inputs.views.cameras = room.cameras;
  inputs.views.num_sources = 1;
  inputs.view_images = torch::rand({3, 3, 24, 32});
  inputs.view_features = torch::ones({3, 4, 3, 4});
  inputs.all_true_depth = room.depth_maps();
  EXPECT_EQ(measure(metric_named("met3r_like"), inputs).absent,
            "no depth and cameras of all views were predicted");
  const auto found = measure(metric_named("met3r_like_true_geometry"), inputs);
  EXPECT_EQ(found.per_view.size(0), 2);
  EXPECT_NEAR(found.mean(), 0, 1e-6);
  inputs.view_depth = inputs.all_true_depth;
  inputs.estimated_cameras = room.cameras;
  EXPECT_NEAR(measure(metric_named("met3r_like"), inputs).mean(), 0, 1e-6);
  EXPECT_GT(measure(metric_named("met3r_like_coverage"), inputs).mean(), 0.5);
  // Of the true pictures there is one as soon as there are their features, whatever was predicted.
  EXPECT_EQ(measure(metric_named("met3r_like_of_truth"), inputs).absent,
            "there are no features of the true pictures");
  inputs.true_features = torch::rand({3, 4, 3, 4});
  const double of_truth = measure(metric_named("met3r_like_of_truth"), inputs).mean();
  EXPECT_GT(of_truth, 0.01);
  inputs.view_features = inputs.true_features;
  EXPECT_EQ(measure(metric_named("met3r_like_true_geometry"), inputs).mean(), of_truth);
}

}  // namespace
}  // namespace gld
