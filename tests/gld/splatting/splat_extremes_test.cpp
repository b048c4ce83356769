// What a set may be at its ends: finite, and right where a double reference exists.
#include "gld/splatting/compositing.h"
#include "gld/splatting/naive_splatting.h"
#include "tests/gld/splatting/random_gaussians.h"
#include "tests/support/error_of.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

struct Drawn {
  SplatView view;
  CompositedView picture;
  ColourGradients gradients;
};

Drawn draw(const GaussianSet& set, const Camera& camera, const ProjectionOptions& options = {}) {
  Drawn drawn;
  drawn.view = view_of_splats(set, splat_camera(camera, set.origin, options), {});
  drawn.picture = render_colours(set, drawn.view, {});
  SplatImage ones(3, camera.width, camera.height);
  for (int64_t c = 0; c < 3; ++c) {
    for (int64_t y = 0; y < camera.height; ++y) std::fill_n(ones.row(c, y), camera.width, 1.0F);
  }
  render_colours_backward(set, drawn.view, view_colours(set, drawn.view, {}), ones, {}, drawn.gradients);
  return drawn;
}

void expect_finite(const Drawn& drawn) {
  for (const float value : drawn.picture.image.values) ASSERT_TRUE(std::isfinite(value));
  for (const float value : drawn.picture.transmittance.values)
    ASSERT_TRUE(std::isfinite(value) && value >= 0 && value <= 1);
  for (const GaussianArray& array : gaussian_arrays(drawn.gradients.of_set)) {
    for (const float value : drawn.gradients.of_set.*array.values)
      ASSERT_TRUE(std::isfinite(value)) << array.name;
  }
}

// Beside the naive picture, where that does not jump; the tolerance is compositing_test's where lengths are ordinary.
void expect_right(const GaussianSet& set, const Camera& camera, double tolerance) {
  const Drawn drawn = draw(set, camera);
  expect_finite(drawn);
  const SplatCamera splat = splat_camera(camera, set.origin, {});
  NaiveScene scene;
  scene.channels = 3;
  scene.width = camera.width;
  scene.height = camera.height;
  for (int64_t i = 0; i < set.size(); ++i) {
    ProjectedGaussian projected;
    if (!project_gaussian(gaussian_shape(set, i), splat, projected)) continue;
    SeenColour colour;
    seen_colour(set, i, projected.from_camera, colour);
    scene.splats.push_back(naive_splat(projected));
    scene.features.insert(scene.features.end(), colour.rgb, colour.rgb + 3);
  }
  const NaiveImage expected = render_naively(scene);
  int64_t compared = 0;
  for (int64_t pixel = 0; pixel < camera.width * camera.height; ++pixel) {
    if (expected.to_jump[static_cast<size_t>(pixel)] < 1e-3) continue;
    ++compared;
    for (int64_t c = 0; c < 3; ++c) {
      ASSERT_NEAR(drawn.picture.image.row(c, pixel / camera.width)[pixel % camera.width],
                  expected.values[static_cast<size_t>(c * camera.width * camera.height + pixel)], tolerance)
          << pixel;
    }
  }
  EXPECT_GT(compared, camera.width * camera.height / 2);
}

GaussianSet with_scales(float low, float middle, float high) {
  GaussianSet set = random_gaussians({});
  for (size_t i = 0; i < set.log_scales.size(); i += 3) {
    set.log_scales[i] = std::log(low);
    set.log_scales[i + 1] = std::log(middle);
    set.log_scales[i + 2] = std::log(high);
  }
  return set;
}

TEST(SplatExtremes, NoGaussian) {
  const Drawn drawn = draw(zero_gaussians(0, 3), splat_test_camera(30, 20));
  expect_finite(drawn);
  EXPECT_EQ(drawn.view.size(), 0);
  for (int64_t y = 0; y < 20; ++y) {
    for (int64_t x = 0; x < 30; ++x) EXPECT_EQ(drawn.picture.transmittance.row(0, y)[x], 1);
  }
}

TEST(SplatExtremes, AllCulled) {
  GaussianSet behind = random_gaussians({});
  for (size_t i = 2; i < behind.means.size(); i += 3) behind.means[i] = -4;
  EXPECT_EQ(draw(behind, splat_test_camera(30, 20)).view.size(), 0);
  GaussianSet faint = random_gaussians({});
  for (float& logit : faint.logit_opacities) logit = -100;  // opacity 0
  const Drawn drawn = draw(faint, splat_test_camera(30, 20));
  EXPECT_EQ(drawn.view.size(), 0);
  expect_finite(drawn);
}

TEST(SplatExtremes, Needles) {
  // 1e6 : 1. Some reach across the picture, most are far outside at both ends.
  expect_right(with_scales(1e-3F, 1e-3F, 1e3F), splat_test_camera(40, 30), 2e-5);
  expect_right(with_scales(1e-6F, 1e-2F, 1.0F), splat_test_camera(40, 30), 2e-6);
}

TEST(SplatExtremes, ScalesFromTinyToHuge) {
  expect_right(with_scales(1e-8F, 1e-8F, 1e-8F), splat_test_camera(40, 30), 2e-6);
  expect_right(with_scales(1e3F, 1e3F, 1e3F), splat_test_camera(40, 30), 2e-6);
  expect_right(with_scales(1e-8F, 1.0F, 1e3F), splat_test_camera(40, 30), 2e-5);
}

TEST(SplatExtremes, CameraInside) {
  GaussianSet set = random_gaussians({});
  Camera camera = splat_test_camera(40, 30);
  camera.world_from_camera.translation() = Eigen::Vector3d(0.1, 0, 4);
  expect_right(set, camera, 2e-6);
}

TEST(SplatExtremes, OpacityOne) {
  GaussianSet set = random_gaussians({});
  for (float& logit : set.logit_opacities) logit = 80;
  expect_right(set, splat_test_camera(40, 30), 2e-6);
}

TEST(SplatExtremes, TenThousandAtOnePlace) {
  GaussianSet set = zero_gaussians(10000, 0);
  for (size_t i = 0; i < 10000; ++i) {
    set.means[3 * i + 2] = 4;
    set.rotations[4 * i] = 1;
    for (size_t k = 0; k < 3; ++k) set.log_scales[3 * i + k] = -1;
    // Equal depths go by index: the first few colours count.
    set.colours[3 * i] = i == 0 ? 1.7F : -1.0F;
  }
  expect_right(set, splat_test_camera(24, 24), 2e-6);
  EXPECT_EQ(draw(set, splat_test_camera(24, 24)).view.splats.front().index, 0);
}

TEST(SplatExtremes, FarFromTheWorldsOrigin) {
  GaussianSet set = random_gaussians({});
  const Camera camera = splat_test_camera(40, 30);
  const Drawn near = draw(set, camera);
  Camera moved = camera;
  const Eigen::Vector3d offset(1e6, -5e5, 2.5e5);
  moved.world_from_camera.translation() += offset;
  set.origin = offset;
  const Drawn far = draw(set, moved);
  double worst = 0;
  for (size_t i = 0; i < near.picture.image.values.size(); ++i)
    worst = std::max<double>(worst, std::abs(near.picture.image.values[i] - far.picture.image.values[i]));
  // A double at 1e6 has steps of 1e-10; no alpha lies that near to 1/255 here.
  EXPECT_LT(worst, 1e-6);
}

TEST(SplatExtremes, LensesAndPictures) {
  for (const double focal : {0.1, 50.0}) {
    Camera camera = splat_test_camera(40, 30);
    camera.intrinsics(0, 0) = camera.intrinsics(1, 1) = focal * 40;
    camera.world_from_camera = Eigen::Isometry3d::Identity();
    SCOPED_TRACE(focal);
    expect_right(random_gaussians({}), camera, 2e-6);
  }
  Camera off = splat_test_camera(40, 30);
  off.intrinsics(0, 2) = -90;
  expect_right(random_gaussians({}), off, 2e-6);
}

TEST(SplatExtremes, WhatIsNoNumberIsNamed) {
  const float nan = std::numeric_limits<float>::quiet_NaN(),
              infinite = std::numeric_limits<float>::infinity();
  GaussianSet set = random_gaussians({});
  set.log_scales[3 * 7 + 1] = nan;
  EXPECT_EQ(error_of([&] { check_gaussians(set, "splats.ply"); }),
            "splats.ply, Gaussian 7: expected a finite log scale, found nan; leave it out or make it again.");
  set = random_gaussians({});
  set.means[3 * 19] = infinite;
  EXPECT_EQ(error_of([&] { check_gaussians(set, "splats.ply"); }),
            "splats.ply, Gaussian 19: expected a finite mean, found inf; leave it out or make it again.");
  set = random_gaussians({});
  std::fill_n(set.rotations.begin() + 4, 4, 0.0F);
  EXPECT_EQ(
      error_of([&] { check_gaussians(set, "splats.ply"); }),
      "splats.ply, Gaussian 1: expected a rotation as a quaternion that is not 0, found 0, 0, 0, 0; leave it out "
      "or make it again.");
}

}  // namespace
}  // namespace gld
