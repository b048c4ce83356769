#include "gld/metrics/trajectory_metrics.h"

#include "gld/base/mixed_bits.h"
#include "gld/files/npy.h"
#include "gld/metrics/metric_list.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/random_cameras.h"

#include <cmath>

#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::HasSubstr;

// The trajectories that tests/data/trajectories is of (its README.md): the same numbers wherever they are drawn.
class SplitMixTrajectories {
 public:
  explicit SplitMixTrajectories(uint64_t seed) : next_(mixed_bits(seed)) {}

  double uniform() { return static_cast<double>(mixed_bits(next_++) >> 11U) * 0x1p-53 * 2 - 1; }
  Eigen::Vector3d vector() {
    const double x = uniform(), y = uniform();
    return {x, y, uniform()};
  }
  Eigen::Matrix3d rotation() {
    for (;;) {
      const double w = uniform(), x = uniform(), y = uniform(), z = uniform();
      const Eigen::Quaterniond q(w, x, y, z);
      if (q.norm() > 0.1 && q.norm() < 1) return q.normalized().toRotationMatrix();
    }
  }
  Eigen::Isometry3d pose() {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = rotation();
    pose.translation() = vector();
    return pose;
  }

 private:
  uint64_t next_;
};

TEST(TrajectoryErrors, AreThoseOfEvoOnAThousandTrajectories) {
  const auto expected = read_npy(test::test_data() / "trajectories" / "evo_errors.npy");
  ASSERT_EQ(expected.shape, (std::vector<int64_t>{1000, 3}));
  const auto numbers = expected.to_doubles();
  for (uint64_t seed = 0; seed < 1000; ++seed) {
    SplitMixTrajectories random(seed);
    std::vector<Eigen::Isometry3d> truth, estimate;
    for (uint64_t i = 0; i < 3 + seed % 8; ++i) truth.push_back(random.pose());
    for (const auto& pose : truth) {
      Eigen::Isometry3d other = Eigen::Isometry3d::Identity();
      other.linear() = random.rotation();
      Eigen::Vector3d centre = pose.translation() + 0.2 * random.vector();
      if (seed % 3 == 0) centre.z() *= -1;  // mirrored: no rotation brings it back
      other.translation() = 2.5 * centre + Eigen::Vector3d(1, 2, 3);
      estimate.push_back(other);
    }
    const TrajectoryErrors errors = trajectory_errors(truth, estimate);
    ASSERT_EQ(errors.degenerate, "");
    ASSERT_NEAR(errors.ate, numbers[3 * seed], 1e-9) << seed;
    ASSERT_NEAR(errors.rpe_translation, numbers[3 * seed + 1], 1e-9) << seed;
    ASSERT_NEAR(errors.rpe_rotation / numbers[3 * seed + 2], 1, 1e-9) << seed;
    ASSERT_LE(errors.ate_over_spread, 1 + 1e-12) << seed;
  }
}

TEST(TrajectoryErrors, AreZeroForASimilarity) {
  SplitMixTrajectories random(5);
  std::vector<Eigen::Isometry3d> truth, estimate;
  const Eigen::Isometry3d motion = random.pose();
  for (int i = 0; i < 6; ++i) {
    truth.push_back(random.pose());
    Eigen::Isometry3d moved = motion * truth.back();
    moved.translation() *= 40;
    estimate.push_back(moved);
  }
  const TrajectoryErrors errors = trajectory_errors(truth, estimate);
  EXPECT_NEAR(errors.ate, 0, 1e-12);
  EXPECT_NEAR(errors.rpe_translation, 0, 1e-12);
  EXPECT_NEAR(errors.rpe_rotation, 0, 1e-6);
  EXPECT_NEAR(errors.scale, 1.0 / 40, 1e-12);
}

TEST(TrajectoryErrors, SayThatATrajectoryIsDegenerate) {
  SplitMixTrajectories random(6);
  std::vector<Eigen::Isometry3d> any, line, place;
  for (int i = 0; i < 5; ++i) {
    any.push_back(random.pose());
    line.push_back(any.back());
    line.back().translation() = Eigen::Vector3d(1, 2, 3) + i * Eigen::Vector3d(0.3, -1, 2);
    place.push_back(any.back());
    place.back().translation() = Eigen::Vector3d(1e4, 2, 3);
  }
  EXPECT_THAT(trajectory_errors(line, any).degenerate, HasSubstr("the scene's cameras stand on a line"));
  EXPECT_THAT(trajectory_errors(any, line).degenerate, HasSubstr("the estimated cameras stand on a line"));
  EXPECT_THAT(trajectory_errors(any, place).degenerate, HasSubstr("the estimated cameras stand on a line"));
  EXPECT_THAT(trajectory_errors({any[0], any[1]}, {any[0], any[1]}).degenerate, HasSubstr("fewer than 3"));
  EXPECT_EQ(test::error_of([&] { trajectory_errors(any, {any[0]}); }),
            "trajectory errors: expected an estimate of each of 5 poses, found 1; estimate all views.");
}

std::vector<Camera> cameras_of(uint32_t seed, int count) {
  test::RandomCameras random(seed);
  std::vector<Camera> cameras;
  cameras.reserve(static_cast<size_t>(count));
  for (int i = 0; i < count; ++i) cameras.push_back(random.ordinary(80, 60));
  return cameras;
}

TEST(PairAccuracy, CountsPairsAndTheAreaBelowTheirErrors) {
  const auto truth = cameras_of(2, 5);
  // Errors of 0 are below every threshold but 0 itself.
  const auto perfect = pair_accuracy(truth, truth, 0);
  ASSERT_TRUE(perfect);
  EXPECT_NEAR(perfect->auc_30, 100, 0.06);
  EXPECT_NEAR(perfect->maa_30, 100, 1e-9);
  EXPECT_EQ(perfect->rotation_15, 100);
  EXPECT_EQ(perfect->direction_15, 100);
  // The last camera is turned by 12.5 degrees: the one pair of views 3 and 4 has that error; directions are right.
  auto turned = truth;
  turned[4].world_from_camera.linear() =
      turned[4].world_from_camera.linear() *
      Eigen::AngleAxisd(12.5 / 57.29577951308232, Eigen::Vector3d::UnitX()).toRotationMatrix();
  const auto found = pair_accuracy(truth, turned, 3);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->auc_3, 0);
  EXPECT_NEAR(found->auc_30, 100 * 17.5 / 30, 0.06);
  EXPECT_NEAR(found->maa_30, 100 * 18.0 / 30, 1e-9);  // below 13, ..., 30
  EXPECT_EQ(found->rotation_15, 100);
  // Of the six pairs of views 1 to 4, three contain it.
  EXPECT_NEAR(pair_accuracy(truth, turned, 1)->auc_3, 50, 0.06);
  // The frame and the unit of the estimate do not count.
  auto moved = turned;
  for (Camera& camera : moved) {
    camera.world_from_camera =
        Eigen::AngleAxisd(2, Eigen::Vector3d(1, 2, 3).normalized()) * camera.world_from_camera;
    camera.world_from_camera.translation() *= 7;
  }
  EXPECT_NEAR(pair_accuracy(truth, moved, 3)->auc_30, found->auc_30, 1e-9);
}

TEST(PairAccuracy, NeedsPairsThatStandApart) {
  auto truth = cameras_of(3, 4);
  EXPECT_FALSE(pair_accuracy(truth, truth, 3));
  truth[3].world_from_camera.translation() = truth[2].world_from_camera.translation();
  EXPECT_FALSE(pair_accuracy(truth, cameras_of(3, 4), 2));
  // A collapsed estimate is wrong, not absent.
  auto collapsed = cameras_of(3, 4);
  collapsed[3].world_from_camera.translation() = collapsed[2].world_from_camera.translation();
  EXPECT_EQ(pair_accuracy(cameras_of(3, 4), collapsed, 2)->direction_15, 0);
}

TEST(TrajectoryMetrics, AreOfTheTargetsAndSayWhyTheyAreAbsent) {
  MetricInputs inputs;
  inputs.views.cameras = cameras_of(4, 5);
  inputs.views.num_sources = 3;
  inputs.missing[MetricNeed::kEstimatedCameras] = "--poses none";
  EXPECT_EQ(measure(metric_named("ate"), inputs).absent, "--poses none");
  inputs.estimated_cameras = inputs.views.cameras;
  EXPECT_THAT(measure(metric_named("ate"), inputs).absent, HasSubstr("degenerate: fewer than 3 views"));
  EXPECT_NEAR(measure(metric_named("ate_of_all_views"), inputs).mean(), 0, 1e-12);
  EXPECT_EQ(measure(metric_named("rotation_accuracy_15"), inputs).mean(), 100);
  inputs.views.num_sources = 2;
  inputs.estimated_cameras[0].world_from_camera.translation() += Eigen::Vector3d(9, 9, 9);  // a source
  EXPECT_NEAR(measure(metric_named("ate"), inputs).mean(), 0, 1e-12);
  EXPECT_GT(measure(metric_named("ate_of_all_views"), inputs).mean(), 0.1);
  EXPECT_NEAR(measure(metric_named("rpe_rotation"), inputs).mean(), 0, 1e-5);
}

}  // namespace
}  // namespace gld
