#include "datasets/registration/bundle_adjustment.h"

#include "gld/base/error.h"

#include <array>
#include <cmath>
#include <set>

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <glog/logging.h>

namespace gld {
namespace {

// How exactly SIFT finds a place, pixels. It weighs the pictures against what is known of lenses beforehand.
constexpr double kPositionSpread = 0.7;
constexpr double kRobustWidth = 1.5;  // in spreads: beyond, an error counts less and less

struct ReprojectionError {
  Eigen::Vector2d position;
  double weight;  // spreads a longer side

  template <typename T>
  bool operator()(const T* lens, const T* pose, const T* point, T* error) const {
    T in_camera[3];
    ceres::AngleAxisRotatePoint(pose, point, in_camera);
    const T x = in_camera[0] + pose[3], y = in_camera[1] + pose[4], z = in_camera[2] + pose[5];
    if (z <= T(0)) return false;  // the solver then tries a shorter step
    const T across = x / z, down = y / z;
    const T scale = exp(lens[0]) * (T(1) + lens[1] * (across * across + down * down));
    error[0] = (scale * across - position.x()) * weight;
    error[1] = (scale * down - position.y()) * weight;
    return true;
  }
};

struct LensPrior {
  double log_focal_length, focal_length_weight, k1_weight;

  template <typename T>
  bool operator()(const T* lens, T* error) const {
    error[0] = (lens[0] - log_focal_length) * focal_length_weight;
    error[1] = lens[1] * k1_weight;
    return true;
  }
};

// Ceres says on the terminal, through glog, when it shortens a step. Nobody can do anything about it.
class QuietLog {
 public:
  QuietLog() : level_(FLAGS_minloglevel) { FLAGS_minloglevel = google::GLOG_ERROR; }
  ~QuietLog() { FLAGS_minloglevel = level_; }
  QuietLog(const QuietLog&) = delete;
  QuietLog& operator=(const QuietLog&) = delete;

 private:
  google::int32 level_;
};

using Pose = std::array<double, 6>;  // angle times axis of camera_from_world, translation

Pose pose_of(const Eigen::Isometry3d& camera_from_world) {
  const Eigen::AngleAxisd turn(camera_from_world.linear());
  const Eigen::Vector3d rotation = turn.angle() * turn.axis(), translation = camera_from_world.translation();
  return {rotation.x(), rotation.y(), rotation.z(), translation.x(), translation.y(), translation.z()};
}

Eigen::Isometry3d transform_of(const Pose& pose) {
  Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
  const Eigen::Vector3d rotation(pose[0], pose[1], pose[2]);
  const double angle = rotation.norm();
  if (angle > 0) transform.linear() = Eigen::AngleAxisd(angle, rotation / angle).toRotationMatrix();
  transform.translation() = Eigen::Vector3d(pose[3], pose[4], pose[5]);
  return transform;
}

}  // namespace

Eigen::Vector2d projected(const BundleLens& lens, const Eigen::Isometry3d& camera_from_world,
                          const Eigen::Vector3d& point_in_world) {
  const Eigen::Vector2d p = (camera_from_world * point_in_world).hnormalized();
  return lens.focal_length * (1 + lens.k1 * p.squaredNorm()) * p;
}

double adjust(Bundle& bundle, int most_iterations, BundlePoints free_points) {
  std::vector<std::array<double, 2>> lenses;
  for (const BundleLens& lens : bundle.lenses) lenses.push_back({std::log(lens.focal_length), lens.k1});
  std::vector<Pose> poses;
  for (const BundleView& view : bundle.views) poses.push_back(pose_of(view.camera_from_world));

  ceres::Problem problem;
  std::set<size_t> used_lenses;
  for (const BundleObservation& observation : bundle.observations) {
    const BundleView& view = bundle.views[observation.view];
    used_lenses.insert(view.lens);
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<ReprojectionError, 2, 2, 6, 3>(
                                 new ReprojectionError{observation.position, view.pixels / kPositionSpread}),
                             new ceres::CauchyLoss(kRobustWidth), lenses[view.lens].data(),
                             poses[observation.view].data(),
                             bundle.points_in_world[observation.point].data());
  }
  for (const size_t number : used_lenses) {
    const BundleLens& lens = bundle.lenses[number];
    double* values = lenses[number].data();
    const auto weight = [](double spread) { return spread > 0 ? 1 / spread : 0; };
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<LensPrior, 2, 2>(new LensPrior{
            std::log(lens.expected_focal_length), weight(lens.focal_length_spread), weight(lens.k1_spread)}),
        nullptr, values);
    if (lens.focal_length_spread <= 0 && lens.k1_spread <= 0) {
      problem.SetParameterBlockConstant(values);
    } else if (lens.k1_spread <= 0) {
      problem.SetManifold(values, new ceres::SubsetManifold(2, {1}));
    } else if (lens.focal_length_spread <= 0) {
      problem.SetManifold(values, new ceres::SubsetManifold(2, {0}));
    }
  }
  for (size_t i = 0; i < poses.size(); ++i) {
    if (!problem.HasParameterBlock(poses[i].data())) continue;
    if (bundle.views[i].freedom == BundleFreedom::kFixed) problem.SetParameterBlockConstant(poses[i].data());
    if (bundle.views[i].freedom != BundleFreedom::kUnit) continue;
    Eigen::Index largest = 0;
    bundle.views[i].camera_from_world.translation().cwiseAbs().maxCoeff(&largest);
    problem.SetManifold(poses[i].data(), new ceres::SubsetManifold(6, {3 + static_cast<int>(largest)}));
  }
  if (free_points == BundlePoints::kFixed) {
    for (Eigen::Vector3d& point : bundle.points_in_world) {
      if (problem.HasParameterBlock(point.data())) problem.SetParameterBlockConstant(point.data());
    }
  }
  ceres::Solver::Options options;
  options.linear_solver_type =
      free_points == BundlePoints::kFixed ? ceres::DENSE_NORMAL_CHOLESKY : ceres::DENSE_SCHUR;
  options.dense_linear_algebra_library_type = ceres::EIGEN;
  options.max_num_iterations = most_iterations;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  const QuietLog quiet;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) {
    fail({"bundle adjustment", "cameras and points that can be moved together", summary.message,
          "leave out the photographs that share least with the others"});
  }
  for (size_t i = 0; i < bundle.lenses.size(); ++i) {
    bundle.lenses[i].focal_length = std::exp(lenses[i][0]);
    bundle.lenses[i].k1 = lenses[i][1];
  }
  for (size_t i = 0; i < bundle.views.size(); ++i) {
    if (bundle.views[i].freedom != BundleFreedom::kFixed)
      bundle.views[i].camera_from_world = transform_of(poses[i]);
  }
  return summary.final_cost;
}

}  // namespace gld
