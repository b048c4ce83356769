#include "gld/metrics/trajectory_metrics.h"

#include "gld/base/error.h"
#include "gld/cameras/angles.h"
#include "gld/cameras/nearest_rotation.h"
#include "gld/cameras/pose_alignment.h"
#include "gld/metrics/metric.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include <Eigen/QR>
#include <Eigen/SVD>

namespace gld {
namespace {

using Poses = std::vector<Eigen::Isometry3d>;

// Centres whose second extent is at most this, relative to the first, lie on a line, about which no rotation is told.
constexpr double kThinnestLine = 1e-6;
constexpr double kOpposite = 180;  // degrees

Eigen::Matrix3Xd centres_of(const Poses& poses) {
  Eigen::Matrix3Xd centres(3, static_cast<Eigen::Index>(poses.size()));
  for (size_t i = 0; i < poses.size(); ++i) {
    centres.col(static_cast<Eigen::Index>(i)) = poses[i].translation();
  }
  return centres;
}

// Centres from their mean, and how thick they are across their longest direction, relative to its length.
struct CentredPoints {
  Eigen::Vector3d mean;
  Eigen::Matrix3Xd points;
  double squares = 0;
  bool on_a_line = true;
};

// Returns the singular values of the points: those of the triangle of their QR decomposition, which is compiled in half
// the time of Eigen's decomposition of a matrix of any length.
Eigen::Vector3d extents_of(const Eigen::Matrix3Xd& points) {
  const Eigen::HouseholderQR<Eigen::MatrixX3d> qr(points.transpose());
  const Eigen::Index rows = std::min<Eigen::Index>(3, points.cols());
  Eigen::Matrix3d triangle = Eigen::Matrix3d::Zero();
  triangle.topRows(rows) = qr.matrixQR().topRows(rows).triangularView<Eigen::Upper>();
  return Eigen::JacobiSVD<Eigen::Matrix3d>(triangle).singularValues();
}

CentredPoints centred(const Poses& poses) {
  CentredPoints result;
  result.points = centres_of(poses);
  result.mean = result.points.rowwise().mean();
  result.points.colwise() -= result.mean;
  result.squares = result.points.squaredNorm();
  const Eigen::Vector3d extents = extents_of(result.points);
  // A place far from the origin is known to its rounding only.
  const double rounding = 1e-14 * (result.mean.norm() + extents[0]);
  result.on_a_line = !(extents[1] > std::max(kThinnestLine * extents[0], rounding));
  return result;
}

// Returns b_from_a of the centres.
Similarity umeyama(const CentredPoints& a, const CentredPoints& b) {
  const Eigen::Matrix3d products = b.points * a.points.transpose();
  Similarity fit;
  fit.rotation = nearest_rotation(products);
  fit.scale = (fit.rotation.transpose() * products).trace() / a.squares;
  fit.translation = b.mean - fit.scale * fit.rotation * a.mean;
  return fit;
}

// The angle is accurate near 0 and near 180 degrees.
double direction_angle(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * kDegreesPerRadian;
}

Poses poses_of(const std::vector<Camera>& cameras, int64_t first_view) {
  Poses poses;
  for (size_t i = static_cast<size_t>(first_view); i < cameras.size(); ++i) {
    poses.push_back(cameras[i].world_from_camera);
  }
  return poses;
}

}  // namespace

TrajectoryErrors trajectory_errors(const Poses& truth, const Poses& estimate) {
  if (truth.size() != estimate.size()) {
    fail({"trajectory errors", "an estimate of each of " + std::to_string(truth.size()) + " poses",
          std::to_string(estimate.size()), "estimate all views"});
  }
  TrajectoryErrors errors;
  if (truth.size() < 3) {
    errors.degenerate = "degenerate: fewer than 3 views, which no similarity can be fitted to";
    return errors;
  }
  const CentredPoints true_points = centred(truth), points = centred(estimate);
  if (true_points.on_a_line) {
    errors.degenerate = "degenerate: the scene's cameras stand on a line or at one place";
    return errors;
  }
  if (points.on_a_line) {
    errors.degenerate = "degenerate: the estimated cameras stand on a line or at one place";
    return errors;
  }
  const Similarity fit = umeyama(points, true_points);
  errors.scale = fit.scale;
  const auto count = static_cast<double>(truth.size());
  Poses aligned;
  double squares = 0;
  for (size_t i = 0; i < truth.size(); ++i) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = fit.rotation * estimate[i].linear();
    pose.translation() = fit * estimate[i].translation();
    squares += (pose.translation() - truth[i].translation()).squaredNorm();
    aligned.push_back(pose);
  }
  errors.ate = std::sqrt(squares / count);
  errors.ate_over_spread = errors.ate / std::sqrt(true_points.squares / count);
  double translation_squares = 0, rotation_squares = 0;
  for (size_t i = 0; i + 1 < truth.size(); ++i) {
    const Eigen::Isometry3d motion = truth[i].inverse() * truth[i + 1];
    const Eigen::Isometry3d estimated = aligned[i].inverse() * aligned[i + 1];
    const double translation = (motion.inverse() * estimated).translation().norm();
    const double rotation = rotation_angle(motion.linear(), estimated.linear());
    translation_squares += translation * translation;
    rotation_squares += rotation * rotation;
    errors.rpe_translation_mean += translation / (count - 1);
    errors.rpe_rotation_mean += rotation / (count - 1);
  }
  errors.rpe_translation = std::sqrt(translation_squares / (count - 1));
  errors.rpe_rotation = std::sqrt(rotation_squares / (count - 1));
  return errors;
}

std::optional<PairAccuracy> pair_accuracy(const std::vector<Camera>& truth,
                                          const std::vector<Camera>& estimate, int64_t first_view) {
  if (truth.size() != estimate.size() || truth.empty()) {
    fail({"accuracy of pairs of poses", "an estimate of each of " + std::to_string(truth.size()) + " cameras",
          std::to_string(estimate.size()), "estimate all views"});
  }
  const Eigen::Isometry3d first = truth.front().camera_from_world();
  const Eigen::Isometry3d estimated_first = estimate.front().camera_from_world();
  std::vector<double> largest, rotations, directions;
  for (size_t i = static_cast<size_t>(first_view); i < truth.size(); ++i) {
    for (size_t j = i + 1; j < truth.size(); ++j) {
      const Eigen::Isometry3d a = first * truth[i].world_from_camera, b = first * truth[j].world_from_camera,
                              c = estimated_first * estimate[i].world_from_camera,
                              d = estimated_first * estimate[j].world_from_camera;
      const Eigen::Vector3d step = b.translation() - a.translation(),
                            estimated = d.translation() - c.translation();
      if (!(step.norm() > 0)) return std::nullopt;
      rotations.push_back(
          rotation_angle(a.linear() * b.linear().transpose(), c.linear() * d.linear().transpose()));
      directions.push_back(estimated.norm() > 0 ? direction_angle(step, estimated) : kOpposite);
      largest.push_back(std::max(rotations.back(), directions.back()));
    }
  }
  if (largest.empty()) return std::nullopt;
  const auto share_below = [](const std::vector<double>& errors, double threshold) {
    return static_cast<double>(
               std::count_if(errors.begin(), errors.end(), [&](double error) { return error < threshold; })) /
           static_cast<double>(errors.size());
  };
  // The trapezoidal rule over 1001 thresholds.
  const auto area = [&](double degrees) {
    constexpr int kSteps = 1000;
    double sum = 0;
    for (int i = 0; i <= kSteps; ++i) {
      sum += share_below(largest, degrees * i / kSteps) * (i == 0 || i == kSteps ? 0.5 : 1.0);
    }
    return 100 * sum / kSteps;
  };
  PairAccuracy accuracy;
  accuracy.auc_3 = area(3);
  accuracy.auc_30 = area(30);
  for (int degrees = 1; degrees <= 30; ++degrees) accuracy.maa_30 += 100 * share_below(largest, degrees) / 30;
  accuracy.rotation_15 = 100 * share_below(rotations, 15);
  accuracy.direction_15 = 100 * share_below(directions, 15);
  return accuracy;
}

namespace {

const std::string kSceneUnits = "scene units";

// The paper's are of the target views alone; with few targets those are on a line, and all views may not be.
enum class TrajectoryViews { kTargets, kAll };

MetricValue value_of_scene(double value) {
  return metric_of_views(torch::full({1}, value, torch::kFloat64), "it is not a number");
}

Metric trajectory_metric(const std::string& name, const std::string& unit, double TrajectoryErrors::*error,
                         TrajectoryViews views) {
  return {name, unit, Better::kLower, {MetricNeed::kEstimatedCameras}, [=](const MetricInputs& inputs) {
            const int64_t first_view = views == TrajectoryViews::kTargets ? inputs.views.num_sources : 0;
            const TrajectoryErrors errors = trajectory_errors(poses_of(inputs.views.cameras, first_view),
                                                              poses_of(inputs.estimated_cameras, first_view));
            return errors.degenerate.empty() ? value_of_scene(errors.*error)
                                             : absent_metric(errors.degenerate);
          }};
}

Metric pair_metric(const std::string& name, double PairAccuracy::*share) {
  return {name, "%", Better::kHigher, {MetricNeed::kEstimatedCameras}, [=](const MetricInputs& inputs) {
            const auto accuracy =
                pair_accuracy(inputs.views.cameras, inputs.estimated_cameras, inputs.views.num_sources);
            if (!accuracy) return absent_metric("degenerate: no two target views stand apart");
            return value_of_scene((*accuracy).*share);
          }};
}

}  // namespace

std::vector<Metric> trajectory_metrics() {
  return {
      trajectory_metric("ate", kSceneUnits, &TrajectoryErrors::ate, TrajectoryViews::kTargets),
      trajectory_metric("ate_over_spread", "", &TrajectoryErrors::ate_over_spread, TrajectoryViews::kTargets),
      trajectory_metric("rpe_translation", kSceneUnits, &TrajectoryErrors::rpe_translation,
                        TrajectoryViews::kTargets),
      trajectory_metric("rpe_rotation", "degrees", &TrajectoryErrors::rpe_rotation,
                        TrajectoryViews::kTargets),
      trajectory_metric("ate_of_all_views", kSceneUnits, &TrajectoryErrors::ate, TrajectoryViews::kAll),
      trajectory_metric("ate_of_all_views_over_spread", "", &TrajectoryErrors::ate_over_spread,
                        TrajectoryViews::kAll),
      pair_metric("rotation_accuracy_15", &PairAccuracy::rotation_15),
      pair_metric("translation_accuracy_15", &PairAccuracy::direction_15),
      pair_metric("pose_auc_3", &PairAccuracy::auc_3),
      pair_metric("pose_auc_30", &PairAccuracy::auc_30),
      pair_metric("pose_maa_30", &PairAccuracy::maa_30)};
}

}  // namespace gld
