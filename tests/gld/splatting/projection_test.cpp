#include "gld/splatting/projection.h"

#include "gld/splatting/spherical_harmonics.h"
#include "gld/splatting/splat_view.h"
#include "tests/gld/splatting/random_gaussians.h"
#include "tests/support/error_of.h"

#include <cmath>
#include <functional>

#include <Eigen/LU>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

// The error of a central difference of step h is about h^2 |f'''| / 6 + 1e-16 |f| / h, 1e-10 of f for this step.
constexpr double kStep = 1e-5;
constexpr double kTolerance = 1e-6;

double difference(double& parameter, const std::function<double()>& value) {
  const double here = parameter;
  parameter = here + kStep;
  const double above = value();
  parameter = here - kStep;
  const double below = value();
  parameter = here;
  return (above - below) / (2 * kStep);
}

// Returns some smooth number of all that a projection gives.
double number_of(const ProjectedGaussian& p) {
  return 0.3 * p.mean[0] - 0.2 * p.mean[1] + 0.011 * p.covariance[0] + 0.007 * p.covariance[1] -
         0.005 * p.covariance[2] + 2 * std::log(p.opacity);
}
ProjectedGradient slopes_of_number() {
  ProjectedGradient gradient;
  gradient.mean = {0.3, -0.2};
  gradient.covariance[0] = 0.011;
  gradient.covariance[1] = 0.0035;  // of each of the two equal numbers of the matrix
  gradient.covariance[2] = -0.005;
  gradient.log_opacity = 2;
  return gradient;
}

void expect_gradient(GaussianShape shape, const SplatCamera& camera) {
  const auto value = [&] {
    ProjectedGaussian projected;
    EXPECT_TRUE(project_gaussian(shape, camera, projected));
    return number_of(projected);
  };
  ProjectedGaussian projected;
  ASSERT_TRUE(project_gaussian(shape, camera, projected));
  GaussianShape gradient;
  project_gaussian_backward(shape, camera, projected, slopes_of_number(), gradient);
  const double scale = 1 + gradient.mean.norm() + gradient.log_scale.norm() + gradient.rotation.norm();
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(gradient.mean[k], difference(shape.mean[k], value), kTolerance * scale) << "mean " << k;
    EXPECT_NEAR(gradient.log_scale[k], difference(shape.log_scale[k], value), kTolerance * scale)
        << "scale " << k;
  }
  for (int k = 0; k < 4; ++k)
    EXPECT_NEAR(gradient.rotation[k], difference(shape.rotation[k], value), kTolerance * scale)
        << "rotation " << k;
  EXPECT_NEAR(gradient.logit_opacity, difference(shape.logit_opacity, value), kTolerance * scale);
}

TEST(Projection, GradientsAreThoseOfDifferences) {
  RandomGaussians wanted;
  const GaussianSet set = random_gaussians(wanted);
  for (const bool antialias : {false, true}) {
    ProjectionOptions options;
    options.antialias = antialias;
    const SplatCamera camera = splat_camera(splat_test_camera(40, 30), set.origin, options);
    for (int64_t i = 0; i < set.size(); ++i) {
      SCOPED_TRACE(i);
      expect_gradient(gaussian_shape(set, i), camera);
    }
  }
}

TEST(Projection, WhereTheJacobianIsHeldTheMeanHasNoGradientThroughIt) {
  GaussianSet set = random_gaussians({});
  const SplatCamera camera = splat_camera(splat_test_camera(40, 30), set.origin, {});
  int64_t held = 0;
  for (int64_t i = 0; i < set.size(); ++i) {
    GaussianShape shape = gaussian_shape(set, i);
    shape.mean[0] += 6;  // far beyond the right edge
    ProjectedGaussian projected;
    if (!project_gaussian(shape, camera, projected)) continue;
    EXPECT_GT(projected.mean[0], 1.3 * 40);
    ++held;
    expect_gradient(shape, camera);
  }
  EXPECT_GT(held, 5);
}

TEST(Projection, IsThatOfSampledPoints) {
  // A small Gaussian is a small cloud of points: J maps their spread as the pinhole camera does.
  GaussianSet set = random_gaussians({});
  const Camera camera = splat_test_camera(400, 300);
  const SplatCamera splat = splat_camera(camera, set.origin, {});
  for (int64_t i = 0; i < 5; ++i) {
    GaussianShape shape = gaussian_shape(set, i);
    shape.log_scale.setConstant(std::log(1e-5));
    shape.log_scale[1] = std::log(3e-5);
    ProjectedGaussian projected;
    ASSERT_TRUE(project_gaussian(shape, splat, projected));
    const auto pixel = [&](const Eigen::Vector3d& x_in_world) {
      const Eigen::Vector3d x = camera.intrinsics * (camera.camera_from_world() * x_in_world);
      return Eigen::Vector2d(x[0] / x[2], x[1] / x[2]);
    };
    const Eigen::Matrix3d rotation =
        Eigen::Quaterniond(shape.rotation[0], shape.rotation[1], shape.rotation[2], shape.rotation[3])
            .normalized()
            .toRotationMatrix();
    Eigen::Matrix2d covariance = kPixelVariance * Eigen::Matrix2d::Identity();
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d step = rotation.col(axis) * std::exp(shape.log_scale[axis]);
      const Eigen::Vector2d moved = (pixel(shape.mean + step) - pixel(shape.mean - step)) / 2;
      covariance += moved * moved.transpose();
    }
    EXPECT_LT((projected.mean - pixel(shape.mean)).norm(), 1e-9);
    // The error is the curvature of the projection over 1e-5 of 4, and the rounding of a difference of pixels of 1e-13
    // to 1e-3.
    EXPECT_NEAR(projected.covariance[0], covariance(0, 0), 1e-9);
    EXPECT_NEAR(projected.covariance[1], covariance(0, 1), 1e-9);
    EXPECT_NEAR(projected.covariance[2], covariance(1, 1), 1e-9);
    EXPECT_NEAR(projected.determinant, covariance.determinant(), 1e-9);
  }
}

// 33,000 that each cover all 65,536 tiles.
TEST(SplatViews, MorePairsThanCanBeNumberedAreRefused) {
  RandomGaussians wanted;
  wanted.count = 33'000;
  wanted.smallest = wanted.largest = 50;
  GaussianSet set = random_gaussians(wanted);
  for (float& opacity : set.logit_opacities) opacity = 3;
  EXPECT_THAT(test::error_of([&] {
                view_of_splats(set, splat_camera(splat_test_camera(4096, 4096), Eigen::Vector3d::Zero(), {}),
                               {});
              }),
              testing::HasSubstr(
                  "expected at most 2^31 - 1 pairs of a Gaussian and a tile that it covers, found 2162"));
}

TEST(Projection, NeedlesKeepTheirDeterminant) {
  // Lengths are 1e6 : 1 along a diagonal: xx yy - xy^2 in double would have an error of 1e-16 * 1e18.
  GaussianSet set = zero_gaussians(1, 0);
  set.means = {0, 0, 4};
  const double angle = 0.6;
  set.rotations = {static_cast<float>(std::cos(angle / 2)), 0, 0, static_cast<float>(std::sin(angle / 2))};
  set.log_scales = {std::log(1e6F), std::log(1.0F), std::log(1.0F)};
  Camera camera = splat_test_camera(100, 100);
  camera.world_from_camera = Eigen::Isometry3d::Identity();
  camera.intrinsics << 100, 0, 50, 0, 100, 50, 0, 0, 1;
  ProjectedGaussian projected;
  ASSERT_TRUE(project_gaussian(gaussian_shape(set, 0), splat_camera(camera, set.origin, {}), projected));
  // The needle lies in the picture's plane: S2 has the eigenvalues (25 s)^2 + .3 exactly; s as the floats have it.
  const double large = 25 * std::exp(static_cast<double>(set.log_scales[0])), small = 25;
  const double expected = (large * large + 0.3) * (small * small + 0.3);
  EXPECT_NEAR(projected.determinant / expected, 1, 1e-12);
}

TEST(SphericalHarmonics, AreOrthonormal) {
  // This sums over the sphere by a product rule that is exact for polynomials of degree 6: 4 nodes of Gauss and
  // Legendre, and 8 angles.
  const double nodes[4] = {0.8611363115940526, 0.3399810435848563, -0.3399810435848563, -0.8611363115940526};
  const double weights[4] = {0.3478548451374538, 0.6521451548625461, 0.6521451548625461, 0.3478548451374538};
  double products[16][16] = {};
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 8; ++j) {
      const double angle = 2 * M_PI * j / 8, radius = std::sqrt(1 - nodes[i] * nodes[i]);
      const double direction[3] = {radius * std::cos(angle), radius * std::sin(angle), nodes[i]};
      double values[16];
      spherical_harmonics(3, direction, values);
      for (int a = 0; a < 16; ++a) {
        for (int b = 0; b < 16; ++b) products[a][b] += weights[i] * (2 * M_PI / 8) * values[a] * values[b];
      }
    }
  }
  for (int a = 0; a < 16; ++a) {
    for (int b = 0; b < 16; ++b) EXPECT_NEAR(products[a][b], a == b ? 1 : 0, 1e-12) << a << " " << b;
  }
}

TEST(SphericalHarmonics, SlopesAreThoseOfDifferences) {
  double direction[3] = {0.3, -0.7, 0.5}, slopes[16][3];
  spherical_harmonic_slopes(3, direction, slopes);
  for (int axis = 0; axis < 3; ++axis) {
    for (int k = 0; k < 16; ++k) {
      const double slope = difference(direction[axis], [&] {
        double values[16];
        spherical_harmonics(3, direction, values);
        return values[k];
      });
      EXPECT_NEAR(slopes[k][axis], slope, 1e-9) << k << " " << axis;
    }
  }
}

TEST(SphericalHarmonics, ACoefficientOfAColourIsSeenAsIt) {
  const double direction[3] = {0.6, 0, 0.8};
  double values[1];
  spherical_harmonics(0, direction, values);
  for (const double colour : {0.0, 0.25, 1.0})
    EXPECT_NEAR(0.5 + coefficient_of_colour(colour) * values[0], colour, 1e-15);
}

}  // namespace
}  // namespace gld
