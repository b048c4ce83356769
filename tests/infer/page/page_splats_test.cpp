#include "infer/page/page_splats.h"

#include "gld/splatting/spherical_harmonics.h"
#include "tests/infer/page/unpacked_planes.h"

#include <array>
#include <cmath>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

namespace gld {
namespace {

// Each Gaussian i of n is another one; its quaternion has any length and sign.
GaussianSet some_gaussians(int64_t n) {
  GaussianSet set = zero_gaussians(n, 1);
  set.origin = Eigen::Vector3d(1e6, 0, 5);
  for (size_t i = 0; i < static_cast<size_t>(n); ++i) {
    const auto x = static_cast<float>(i);
    for (size_t k = 0; k < 3; ++k) {
      set.means[3 * i + k] = std::sin(x + 2 * static_cast<float>(k));
      set.log_scales[3 * i + k] = -4 + 0.1F * static_cast<float>(k) * std::cos(x);
      set.colours[3 * i + k] =
          static_cast<float>(coefficient_of_colour(0.5 + 0.4 * std::sin(x * static_cast<float>(k + 1))));
    }
    for (size_t k = 0; k < 4; ++k) set.rotations[4 * i + k] = 3 * std::cos(x + static_cast<float>(k));
    set.logit_opacities[i] = 3 * std::sin(x);
  }
  return set;
}

TEST(PageSplats, AreTheGaussiansToTheirBits) {
  const GaussianSet set = some_gaussians(50);
  const Eigen::Vector3d origin(1e6, 1, 5);
  const auto json = page_splats(set, origin, 1000);
  EXPECT_EQ(json.at("count"), 50);
  EXPECT_EQ(json.at("of"), 50);
  test::UnpackedPlanes planes(json, 17);
  const auto points = planes.points();
  std::array<std::vector<uint8_t>, 11> rest;
  for (auto& plane : rest) plane = planes.plane();
  const double low = json.at("scale_low"), step = json.at("scale_step");
  for (size_t i = 0; i < 50; ++i) {
    const Eigen::Vector3d mean(set.means[3 * i], set.means[3 * i + 1], set.means[3 * i + 2]);
    EXPECT_LT((points[i] + origin - set.origin - mean).cwiseAbs().maxCoeff(), 2.0 / 131070 + 1e-6);
    Eigen::Quaterniond kept, given;
    double length = 0;
    for (size_t k = 0; k < 3; ++k) {
      EXPECT_NEAR(low + step * rest[k][i], set.log_scales[3 * i + k], 0.51 * step);
      EXPECT_NEAR(rest[7 + k][i] / 255.0, colour_of_coefficient(set.colours[3 * i + k]), 0.51 / 255);
    }
    for (size_t k = 0; k < 4; ++k) length += std::pow(set.rotations[4 * i + k], 2);
    EXPECT_GT(length, 0);
    kept = Eigen::Quaterniond(rest[3][i] - 128.0, rest[4][i] - 128.0, rest[5][i] - 128.0, rest[6][i] - 128.0)
               .normalized();
    given = Eigen::Quaterniond(set.rotations[4 * i], set.rotations[4 * i + 1], set.rotations[4 * i + 2],
                               set.rotations[4 * i + 3])
                .normalized();
    EXPECT_LT(kept.angularDistance(given), 0.02);
    EXPECT_NEAR(rest[10][i] / 255.0, 1 / (1 + std::exp(-set.logit_opacities[i])), 0.51 / 255);
  }
}

TEST(PageSplats, WhereThereAreTooManyThoseThatCoverMostStay) {
  GaussianSet set = some_gaussians(10);
  std::fill(set.logit_opacities.begin(), set.logit_opacities.end(), 0.F);
  std::fill(set.log_scales.begin(), set.log_scales.end(), -5.F);
  for (const size_t i : {2, 7}) {
    set.log_scales[3 * i] = set.log_scales[3 * i + 1] = -2;
    for (size_t k = 0; k < 3; ++k)
      set.colours[3 * i + k] = static_cast<float>(coefficient_of_colour(0.08 * static_cast<double>(i)));
  }
  set.log_scales[3 * 4] = -1;  // a needle covers less
  const auto json = page_splats(set, set.origin, 2);
  EXPECT_EQ(json.at("of"), 10);
  test::UnpackedPlanes planes(json, 17);
  planes.points();
  for (int k = 0; k < 7; ++k) planes.plane();
  EXPECT_EQ(planes.plane(), (std::vector<uint8_t>{41, 143})) << "in the order of the set";
}

TEST(PageSplats, OfNoneAreNone) {
  const auto json = page_splats(zero_gaussians(0, 0), Eigen::Vector3d::Zero(), 10);
  EXPECT_EQ(json.at("count"), 0);
  EXPECT_FALSE(json.contains("bytes"));
}

}  // namespace
}  // namespace gld
