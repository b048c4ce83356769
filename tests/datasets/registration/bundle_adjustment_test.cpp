#include "datasets/registration/bundle_adjustment.h"

#include "gld/cameras/pose_alignment.h"

#include <random>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Without noise the truth is the only bundle without an error, up to what is held.
TEST(BundleAdjustment, FindsLensCamerasAndPointsFromWrongOnes) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1, 1);
  Bundle truth;
  truth.lenses = {{0.8, -0.04, 0.8, 0.5, 0.5}};
  for (int i = 0; i < 4; ++i) {
    BundleView view;
    view.camera_from_world.linear() =
        Eigen::AngleAxisd(0.1 * i, Eigen::Vector3d(0.3, 1, 0.1).normalized()).matrix();
    view.camera_from_world.translation() = Eigen::Vector3d(-0.5 * i, 0.1 * i, 0.2 * i);
    view.pixels = 1000;
    truth.views.push_back(view);
  }
  truth.views[0].freedom = BundleFreedom::kFixed;
  truth.views[1].freedom = BundleFreedom::kUnit;
  for (size_t n = 0; n < 60; ++n) {
    truth.points_in_world.emplace_back(2 * unit(random), 1.5 * unit(random), 5 + unit(random));
    for (size_t i = 0; i < truth.views.size(); ++i) {
      truth.observations.push_back(
          {i, n, projected(truth.lenses[0], truth.views[i].camera_from_world, truth.points_in_world[n])});
    }
  }
  Bundle wrong = truth;
  wrong.lenses[0].focal_length = 0.9;
  wrong.lenses[0].k1 = 0;
  for (size_t i = 1; i < 4; ++i) {
    wrong.views[i].camera_from_world.prerotate(
        Eigen::AngleAxisd(0.02, Eigen::Vector3d(unit(random), 1, 0).normalized()));
    if (i > 1) wrong.views[i].camera_from_world.translation().x() += 0.05 * unit(random);
  }
  for (Eigen::Vector3d& point : wrong.points_in_world)
    point += 0.1 * Eigen::Vector3d(unit(random), unit(random), unit(random));
  adjust(wrong, 200);
  // The prior's middle is the true focal length; that of k1 is 0, and half a unit wide: against 480 observations of
  // a 1400th it moves k1 by less than 1e-4.
  EXPECT_NEAR(wrong.lenses[0].focal_length, 0.8, 1e-3);
  EXPECT_NEAR(wrong.lenses[0].k1, -0.04, 1e-3);
  for (size_t i = 0; i < 4; ++i) {
    EXPECT_LT(
        rotation_angle(wrong.views[i].camera_from_world.linear(), truth.views[i].camera_from_world.linear()),
        0.02);
    EXPECT_LT(
        (wrong.views[i].camera_from_world.translation() - truth.views[i].camera_from_world.translation())
            .norm(),
        0.02);  // a camera that is turned by so much about points at a distance of 1 moves as far
  }
}

TEST(BundleAdjustment, HoldsWhatHasNoSpread) {
  Bundle bundle;
  bundle.lenses = {{1, 0, 1, 0, 0}};
  bundle.views.resize(2);
  bundle.views[0].freedom = BundleFreedom::kFixed;
  bundle.views[1].camera_from_world.translation().x() = -1;
  bundle.views[0].pixels = bundle.views[1].pixels = 1000;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> unit(-1, 1);
  for (size_t n = 0; n < 20; ++n) {
    const Eigen::Vector3d point(unit(random), unit(random), 4 + unit(random));
    bundle.points_in_world.push_back(point);
    for (size_t i = 0; i < 2; ++i) {
      bundle.observations.push_back(
          {i, n, 1.2 * projected(bundle.lenses[0], bundle.views[i].camera_from_world, point)});
    }
  }
  adjust(bundle, 20);
  EXPECT_EQ(bundle.lenses[0].focal_length, 1);
  EXPECT_EQ(bundle.lenses[0].k1, 0);
  EXPECT_EQ(bundle.views[0].camera_from_world.matrix(), Eigen::Matrix4d::Identity());
}

}  // namespace
}  // namespace gld
