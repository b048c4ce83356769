#pragma once

#include <Eigen/Core>

namespace gld {

// Returns the rotation R for which trace(R^T matrix) is largest, which is the one nearest to the matrix (orthogonal
// Procrustes, Kabsch 1976): U diag(1, 1, det U V^T) V^T of its singular value decomposition. With matrix = sum of
// b_i a_i^T it turns the a_i as near as possible to the b_i.
Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& matrix);

}  // namespace gld
