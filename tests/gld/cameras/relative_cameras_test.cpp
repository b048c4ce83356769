#include "gld/cameras/relative_cameras.h"

#include "tests/support/error_of.h"
#include "tests/support/random_cameras.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

double largest_difference(const Views& a, const Views& b) {
  double largest = 0;
  for (size_t i = 0; i < a.cameras.size(); ++i) {
    largest =
        std::max(largest, (a.cameras[i].world_from_camera.matrix() - b.cameras[i].world_from_camera.matrix())
                              .cwiseAbs()
                              .maxCoeff());
  }
  return largest;
}

TEST(RelativeCameras, LastViewIsTheIdentityAndTheLargestComponentIsOne) {
  test::RandomCameras random(1);
  const Views views = random.ordinary_scene({});
  const auto relative = relative_cameras(views);
  EXPECT_LT((relative.views.cameras.back().world_from_camera.matrix() - Eigen::Matrix4d::Identity()).norm(),
            1e-14);
  double largest = 0;
  for (const Camera& camera : relative.views.cameras) {
    largest = std::max(largest, camera.world_from_camera.translation().cwiseAbs().maxCoeff());
  }
  EXPECT_NEAR(largest, 1.0, 1e-7);
  EXPECT_TRUE(relative.warnings.empty());
  EXPECT_EQ(relative.views.num_sources, 2);
}

TEST(RelativeCameras, PointsKeepTheirPlaceInEveryCamera) {
  test::RandomCameras random(2);
  const Views views = random.ordinary_scene({});
  const auto relative = relative_cameras(views);
  const Eigen::Vector3d in_world(0.3, -0.2, 4.0);
  const Eigen::Vector3d in_reference =
      views.cameras.back().world_from_camera.inverse() * in_world * relative.translation_scale;
  for (size_t i = 0; i < views.cameras.size(); ++i) {
    const Eigen::Vector3d expected =
        views.cameras[i].world_from_camera.inverse() * in_world * relative.translation_scale;
    EXPECT_LT((relative.views.cameras[i].world_from_camera.inverse() * in_reference - expected).norm(),
              1e-13);
  }
}

TEST(RelativeCameras, DoNotSeeTheWorldsOrigin) {
  test::RandomCameras random(3);
  const Views views = random.ordinary_scene({});
  const auto near = relative_cameras(views);
  for (const double offset : {1e2, 1e3, 1e6}) {
    Views moved = views;
    for (Camera& camera : moved.cameras) {
      camera.world_from_camera.translation() += Eigen::Vector3d(offset, -0.5 * offset, 0.7 * offset);
    }
    const auto far = relative_cameras(moved);
    EXPECT_TRUE(far.warnings.empty());
    // What is left is the rounding of the moved coordinates themselves.
    EXPECT_LT(largest_difference(near.views, far.views), offset * 1e-15) << offset;
  }
}

TEST(RelativeCameras, PureRotationHasNoBaseline) {
  test::RandomCameras random(4);
  Views views = random.ordinary_scene({});
  for (Camera& camera : views.cameras) {
    camera.world_from_camera.translation() = Eigen::Vector3d(3.1, -2.7, 12.3);
    // The rounding of a pose that went through its inverse.
    camera.world_from_camera = camera.world_from_camera.inverse().inverse();
  }
  const auto relative = relative_cameras(views);
  EXPECT_EQ(relative.translation_scale, 1.0);
  for (const Camera& camera : relative.views.cameras) {
    EXPECT_EQ(camera.world_from_camera.translation(), Eigen::Vector3d::Zero());
  }
  EXPECT_EQ(
      relative.warnings,
      (std::vector<std::string>{
          "the camera centres coincide, so there is no baseline: translations are taken as exactly zero"}));
}

TEST(RelativeCameras, SinglePrecisionNoiseIsNoBaseline) {
  test::RandomCameras random(5);
  Views views = random.ordinary_scene({});
  for (Camera& camera : views.cameras) {
    const float x = 12.3F * (1.0F + static_cast<float>(random.integer(0, 1)) * 1.2e-7F);
    camera.world_from_camera.translation() = Eigen::Vector3d(x, 0.5, -3.0);
  }
  EXPECT_EQ(relative_cameras(views).translation_scale, 1.0);
}

TEST(RelativeCameras, TinyAndHugeScenesKeepTheirShape) {
  test::RandomCameras random(6);
  const Views views = random.ordinary_scene({});
  const auto unit = relative_cameras(views);
  for (const double scale : {1e-6, 1e8}) {
    Views scaled = views;
    for (Camera& camera : scaled.cameras) camera.world_from_camera.translation() *= scale;
    const auto relative = relative_cameras(scaled);
    EXPECT_TRUE(relative.warnings.empty());
    // 1e-8 is added to the largest component, as published.
    EXPECT_LT(largest_difference(unit.views, relative.views), 1e-8 / scale + 1e-7) << scale;
  }
}

TEST(RelativeCameras, TheLargestDistanceIsOneHoweverTheReferenceIsTurned) {
  test::RandomCameras random(7);
  Views views = random.ordinary_scene({});
  const auto largest = [](const RelativeCameras& relative) {
    double distance = 0;
    for (const Camera& camera : relative.views.cameras) {
      distance = std::max(distance, camera.world_from_camera.translation().norm());
    }
    return distance;
  };
  const auto by_distance = relative_cameras(views, -1, TranslationUnit::kLargestDistance);
  EXPECT_NEAR(largest(by_distance), 1.0, 1e-7);
  const auto by_component = relative_cameras(views);
  EXPECT_GT(largest(by_component), 1.01);
  views.cameras.back().world_from_camera.rotate(
      Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()));
  EXPECT_NEAR(relative_cameras(views, -1, TranslationUnit::kLargestDistance).translation_scale,
              by_distance.translation_scale, 1e-9 * by_distance.translation_scale);
  EXPECT_GT(std::abs(relative_cameras(views).translation_scale / by_component.translation_scale - 1), 1e-3);
}

TEST(RelativeCameras, AnyViewCanBeTheReference) {
  test::RandomCameras random(8);
  const Views views = random.ordinary_scene({});
  const auto relative = relative_cameras(views, 1);
  EXPECT_LT((relative.views.cameras[1].world_from_camera.matrix() - Eigen::Matrix4d::Identity()).norm(),
            1e-14);
  EXPECT_EQ(test::error_of([&] { relative_cameras(views, 4); }),
            "reference_view: expected one of 4 views, found 4; use -1 for the last view.");
}

TEST(RelativeCameras, TenThousandExtremeScenesStayFiniteAndBounded) {
  test::RandomCameras random(9);
  int without_baseline = 0;
  for (int i = 0; i < 10000; ++i) {
    const auto relative = relative_cameras(random.extreme_scene());
    without_baseline += relative.warnings.empty() ? 0 : 1;
    ASSERT_TRUE(std::isfinite(relative.translation_scale));
    ASSERT_GT(relative.translation_scale, 0);
    for (const Camera& camera : relative.views.cameras) {
      ASSERT_TRUE(camera.world_from_camera.matrix().allFinite());
      ASSERT_LE(camera.world_from_camera.translation().cwiseAbs().maxCoeff(), 1.0 + 1e-12);
    }
  }
  EXPECT_GT(without_baseline, 2000);
  EXPECT_LT(without_baseline, 6000);
}

TEST(LiftedIntrinsics, AreThoseOfTheDesign) {
  Eigen::Matrix3d k;
  k << 50, 0, 40, 0, 60, 30, 0, 0, 1;
  Eigen::Matrix4d expected;
  expected << 0.5, 0, -0.1, 0, 0, 1.2, 0.1, 0, 0, 0, 1, 0, 0, 0, 0, 1;
  EXPECT_LT((lifted_intrinsics(k, 100, 50) - expected).norm(), 1e-15);
}

}  // namespace
}  // namespace gld
