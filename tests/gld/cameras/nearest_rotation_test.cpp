#include "gld/cameras/nearest_rotation.h"

#include <random>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

namespace gld {
namespace {

// No rotation has a larger trace with the matrix, of a mirroring one and of one of rank 1 neither.
TEST(NearestRotation, IsTheRotationOfLargestTrace) {
  std::mt19937 engine(4);
  std::normal_distribution<double> normal;
  for (int which = 0; which < 30; ++which) {
    Eigen::Matrix3d matrix;
    for (double& value : matrix.reshaped()) value = normal(engine);
    if (which % 3 == 0 && matrix.determinant() > 0) matrix.col(0) *= -1;
    if (which % 5 == 0) matrix = Eigen::Matrix3d(matrix.col(1) * matrix.row(2));
    const Eigen::Matrix3d rotation = nearest_rotation(matrix);
    EXPECT_LT((rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-12);
    EXPECT_NEAR(rotation.determinant(), 1, 1e-12);
    const double best = (rotation.transpose() * matrix).trace();
    for (int other = 0; other < 50; ++other) {
      const Eigen::Vector3d axis =
          Eigen::Vector3d(normal(engine), normal(engine), normal(engine)).normalized();
      const Eigen::Matrix3d turned =
          Eigen::AngleAxisd((other % 2 == 0 ? 0.02 : 1.0) * normal(engine), axis) * rotation;
      EXPECT_LE((turned.transpose() * matrix).trace(), best + 1e-12);
    }
  }
}

// A rotation that a little noise was added to comes back; points that were turned tell by how much.
TEST(NearestRotation, FindsTheTurnOfPoints) {
  const Eigen::Matrix3d truth =
      Eigen::AngleAxisd(2.9, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix();
  Eigen::Matrix3Xd points(3, 6);
  points << 1, 0, 0, 2, -1, 0.3, 0, 1, 0, 1, 2, -0.7, 0, 0, 1, -1, 0.5, 1;
  EXPECT_LT((nearest_rotation(truth * points * points.transpose()) - truth).norm(), 1e-12);
  EXPECT_LT((nearest_rotation(truth + 1e-6 * Eigen::Matrix3d::Ones()) - truth).norm(), 1e-5);
}

}  // namespace
}  // namespace gld
