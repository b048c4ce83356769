#include "gld/photogrammetry/pose_from_rays.h"

#include "gld/base/error.h"
#include "gld/cameras/angles.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/QR>

namespace gld {
namespace {

using Matrix7d = Eigen::Matrix<double, 7, 7>;
using Vector7d = Eigen::Matrix<double, 7, 1>;
using Matrix9d = Eigen::Matrix<double, 9, 9>;

constexpr size_t kFewestRays = 16;
constexpr double kCauchyWidth = 2.385;  // 95 % efficient on normal noise
constexpr double kMedianToSigma = 1.4826;
constexpr double kSmallestSigma = 1e-9;  // keeps exact rays from dividing by zero

// With this reach the mean of pixel * pixel^T over the picture is the identity. Outliers in all directions then add a
// multiple of the identity to the normal equations of the linear fit, which leaves its eigenvectors alone.
constexpr double kReach = 1.7320508075688772;

struct Ray {
  Eigen::Vector3d pixel;  // (u, v, 1), u and v from -1 to 1 over the picture: keeps the equations well scaled
  Eigen::Vector3d direction;  // length 1
  Eigen::Vector3d origin;
  double confidence = 1;
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::vector<Ray> usable_rays(const RayMap& map, const ConfidenceMap& confidence) {
  std::vector<Ray> rays;
  for (int64_t y = 0; y < map.height; ++y) {
    for (int64_t x = 0; x < map.width; ++x) {
      const float* values = map.ray(x, y);
      const float sureness = confidence.empty() ? 1.0F : confidence.at(x, y);
      if (!std::all_of(values, values + 6, [](float value) { return std::isfinite(value); })) continue;
      if (!(sureness > 0) || !std::isfinite(sureness)) continue;
      Ray ray;
      ray.direction = Eigen::Vector3d(values[0], values[1], values[2]);
      if (ray.direction.norm() < 1e-30) continue;
      ray.direction.normalize();
      ray.origin = Eigen::Vector3d(values[3], values[4], values[5]);
      const double u = (2 * static_cast<double>(x) + 1) / static_cast<double>(map.width) - 1;
      const double v = (2 * static_cast<double>(y) + 1) / static_cast<double>(map.height) - 1;
      ray.pixel = {kReach * u, kReach * v, 1};
      ray.confidence = sureness;
      rays.push_back(ray);
    }
  }
  return rays;
}

// Makes confidences relative to their median and at most 10, so that no single ray decides.
void level_confidences(std::vector<Ray>& rays) {
  std::vector<double> values;
  values.reserve(rays.size());
  for (const Ray& ray : rays) values.push_back(ray.confidence);
  const double middle = median(values);
  for (Ray& ray : rays) ray.confidence = std::min(ray.confidence / middle, 10.0);
}

// Returns Cauchy weights times confidences for residuals whose scale is their own median.
std::vector<double> robust_weights(const std::vector<Ray>& rays, const std::vector<double>& residuals) {
  const double sigma = std::max(kMedianToSigma * median(residuals), kSmallestSigma);
  std::vector<double> weights(rays.size());
  for (size_t i = 0; i < rays.size(); ++i) {
    const double relative = residuals[i] / (kCauchyWidth * sigma);
    weights[i] = rays[i].confidence / (1 + relative * relative);
  }
  return weights;
}

double sine_of_angle(const Eigen::Vector3d& unit, const Eigen::Vector3d& other) {
  // Opposite directions count as the worst, not as equal.
  return unit.dot(other) <= 0 ? 1.0 : unit.cross(other).norm() / other.norm();
}

// Returns the 3x3 matrix of the linear fit, with the sign that maps pixels in front of the camera.
Eigen::Matrix3d linear_fit(const std::vector<Ray>& rays) {
  std::vector<double> weights;
  weights.reserve(rays.size());
  for (const Ray& ray : rays) weights.push_back(ray.confidence);
  std::vector<double> residuals(rays.size());
  Eigen::Matrix3d fit = Eigen::Matrix3d::Zero();
  for (int iteration = 0; iteration < 12; ++iteration) {
    // A first fit that outliers have spoilt may be near zero at some pixel, which must not take all the weight.
    double shortest = 0;
    for (const Ray& ray : rays) shortest += 0.1 * (fit * ray.pixel).norm() / static_cast<double>(rays.size());
    Matrix9d normal = Matrix9d::Zero();
    for (size_t i = 0; i < rays.size(); ++i) {
      const Eigen::Vector3d& d = rays[i].direction;
      const double length = iteration == 0 ? 1.0 : std::max((fit * rays[i].pixel).norm(), shortest);
      const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - d * d.transpose();
      const Eigen::Matrix3d pixels =
          rays[i].pixel * rays[i].pixel.transpose() * (weights[i] / (length * length));
      for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) normal.block<3, 3>(3 * r, 3 * c) += across(r, c) * pixels;
      }
    }
    const Eigen::SelfAdjointEigenSolver<Matrix9d> eigen(normal);
    if (eigen.eigenvalues()[1] < 1e-10 * eigen.eigenvalues()[8]) {
      fail({"camera from rays", "rays that spread over the picture", "rays that fit many cameras",
            "check the ray map"});
    }
    const Eigen::Matrix<double, 9, 1> smallest = eigen.eigenvectors().col(0);
    fit = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(smallest.data());
    double forward = 0;
    for (size_t i = 0; i < rays.size(); ++i) {
      forward += weights[i] * rays[i].direction.dot((fit * rays[i].pixel).normalized());
    }
    if (forward < 0) fit = -fit;
    for (size_t i = 0; i < rays.size(); ++i) {
      residuals[i] = sine_of_angle(rays[i].direction, fit * rays[i].pixel);
    }
    weights = robust_weights(rays, residuals);
  }
  return fit;
}

// A pinhole camera in the scaled pixels of Ray.
struct Pinhole {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector2d focal{1, 1};
  Eigen::Vector2d principal{0, 0};

  Eigen::Vector3d in_camera(const Eigen::Vector3d& pixel) const {
    return {(pixel[0] - principal[0]) / focal[0], (pixel[1] - principal[1]) / focal[1], 1};
  }
};

Pinhole pinhole_of(const Eigen::Matrix3d& fit) {
  const Eigen::HouseholderQR<Eigen::Matrix3d> qr(fit);
  Eigen::Matrix3d rotation = qr.householderQ();
  Eigen::Matrix3d upper = qr.matrixQR().triangularView<Eigen::Upper>();
  for (int i = 0; i < 3; ++i) {
    if (upper(i, i) >= 0) continue;
    rotation.col(i) *= -1;
    upper.row(i) *= -1;
  }
  if (rotation.determinant() < 0) {
    fail({"camera from rays", "rays of a camera", "mirrored rays", "check the axis convention"});
  }
  if (upper.diagonal().minCoeff() < 1e-9 * upper.diagonal().maxCoeff()) {
    fail({"camera from rays", "rays that spread over the picture", "rays that fit many cameras",
          "check the ray map"});
  }
  const Eigen::Matrix3d intrinsics = upper.inverse() * upper(2, 2);
  Pinhole pinhole;
  pinhole.rotation = rotation;
  pinhole.focal = {intrinsics(0, 0), intrinsics(1, 1)};
  pinhole.principal = {intrinsics(0, 2), intrinsics(1, 2)};
  return pinhole;
}

// Returns the derivatives of the ray's unit direction by a turn of the camera (3), the logarithms of the focal lengths
// (2) and the principal point over the focal lengths (2).
Eigen::Matrix<double, 3, 7> jacobian(const Pinhole& pinhole, const Eigen::Vector3d& in_camera) {
  const double length = in_camera.norm();
  const Eigen::Vector3d unit = in_camera / length;
  const Eigen::Vector3d turned = pinhole.rotation * unit;
  const Eigen::Matrix3d by_point =
      pinhole.rotation * (Eigen::Matrix3d::Identity() - unit * unit.transpose()) / length;
  Eigen::Matrix<double, 3, 7> result;
  result.leftCols<3>() << 0, turned[2], -turned[1], -turned[2], 0, turned[0], turned[1], -turned[0], 0;
  result.col(3) = -in_camera[0] * by_point.col(0);
  result.col(4) = -in_camera[1] * by_point.col(1);
  result.col(5) = -by_point.col(0);
  result.col(6) = -by_point.col(1);
  return result;
}

std::vector<double> angles(const std::vector<Ray>& rays, const Pinhole& pinhole) {
  std::vector<double> result;
  result.reserve(rays.size());
  for (const Ray& ray : rays) {
    const Eigen::Vector3d expected = (pinhole.rotation * pinhole.in_camera(ray.pixel)).normalized();
    result.push_back(std::atan2(ray.direction.cross(expected).norm(), ray.direction.dot(expected)));
  }
  return result;
}

// The first so many of the turn (3), the focal lengths (2) and the principal point (2) are found.
enum Unknowns { kTurn = 3, kTurnAndFocalLengths = 5, kAll = 7 };

void refine(const std::vector<Ray>& rays, Unknowns unknowns, Pinhole& pinhole) {
  for (int iteration = 0; iteration < 12; ++iteration) {
    const std::vector<double> weights = robust_weights(rays, angles(rays, pinhole));
    Matrix7d normal = Matrix7d::Zero();
    Vector7d right = Vector7d::Zero();
    for (size_t i = 0; i < rays.size(); ++i) {
      const Eigen::Vector3d in_camera = pinhole.in_camera(rays[i].pixel);
      const Eigen::Vector3d error = rays[i].direction - (pinhole.rotation * in_camera).normalized();
      const Eigen::Matrix<double, 3, 7> slope = jacobian(pinhole, in_camera);
      normal += weights[i] * slope.transpose() * slope;
      right += weights[i] * slope.transpose() * error;
    }
    // A step of at most half a radian, or half in the logarithm, keeps a poor start from running away.
    Eigen::VectorXd step = normal.topLeftCorner(unknowns, unknowns).ldlt().solve(right.head(unknowns));
    if (!step.allFinite()) return;
    step *= std::min(1.0, 0.5 / std::max(step.cwiseAbs().maxCoeff(), 1e-12));
    const Eigen::Vector3d turn = step.head<3>();
    if (turn.norm() > 0) {
      pinhole.rotation = Eigen::AngleAxisd(turn.norm(), turn.normalized()) * pinhole.rotation;
    }
    if (unknowns >= kTurnAndFocalLengths) {
      pinhole.focal = pinhole.focal.cwiseProduct(Eigen::Vector2d(std::exp(step[3]), std::exp(step[4])));
    }
    if (unknowns == kAll) pinhole.principal += pinhole.focal.cwiseProduct(step.tail<2>());
    if (step.norm() < 1e-12) break;
  }
  pinhole.rotation = Eigen::Quaterniond(pinhole.rotation).normalized().toRotationMatrix();
}

Eigen::Vector3d robust_centre(const std::vector<Ray>& rays, double& origin_error) {
  Eigen::Vector3d centre;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    values.reserve(rays.size());
    for (const Ray& ray : rays) values.push_back(ray.origin[axis]);
    centre[axis] = median(values);
  }
  std::vector<double> distances(rays.size());
  for (int iteration = 0; iteration < 20; ++iteration) {
    for (size_t i = 0; i < rays.size(); ++i) distances[i] = (rays[i].origin - centre).norm();
    const std::vector<double> weights = robust_weights(rays, distances);
    Eigen::Vector3d shift = Eigen::Vector3d::Zero();
    double sum = 0;
    for (size_t i = 0; i < rays.size(); ++i) {
      shift += weights[i] * (rays[i].origin - centre);
      sum += weights[i];
    }
    centre += shift / sum;
  }
  origin_error = median(distances);
  return centre;
}

}  // namespace

RecoveredCamera camera_from_rays(const RayMap& map, const ConfidenceMap& confidence, const ImageSize& size,
                                 const std::optional<KnownIntrinsics>& known) {
  if (!confidence.empty() && (confidence.width != map.width || confidence.height != map.height)) {
    fail({"camera from rays",
          "confidences of the rays' size " + std::to_string(map.width) + "x" + std::to_string(map.height),
          std::to_string(confidence.width) + "x" + std::to_string(confidence.height),
          "check what made them"});
  }
  std::vector<Ray> rays = usable_rays(map, confidence);
  if (rays.size() < kFewestRays) {
    fail({"camera from rays", "at least 16 finite rays with a positive confidence",
          std::to_string(rays.size()), "check the ray map"});
  }
  level_confidences(rays);
  Pinhole pinhole = pinhole_of(linear_fit(rays));
  const Eigen::Vector2d half(static_cast<double>(size.width) / 2, static_cast<double>(size.height) / 2);
  Unknowns unknowns = kAll;
  if (known) {
    // The turn that moving the principal point asks for is found by the refinement.
    pinhole.principal = kReach * (known->principal_point.cwiseQuotient(half) - Eigen::Vector2d::Ones());
    if (known->focal_lengths) pinhole.focal = kReach * known->focal_lengths->cwiseQuotient(half);
    unknowns = known->focal_lengths ? kTurn : kTurnAndFocalLengths;
  }
  refine(rays, unknowns, pinhole);

  RecoveredCamera recovered;
  const std::vector<double> errors = angles(rays, pinhole);
  recovered.direction_error = median(errors) * kDegreesPerRadian;
  const double believed = 3 * std::max(kMedianToSigma * median(errors), kSmallestSigma);
  recovered.inliers = static_cast<double>(std::count_if(errors.begin(), errors.end(),
                                                        [&](double error) { return error <= believed; })) /
                      static_cast<double>(errors.size());
  Camera& camera = recovered.camera;
  camera.width = size.width;
  camera.height = size.height;
  for (int i = 0; i < 2; ++i) {
    camera.intrinsics(i, i) = pinhole.focal[i] / kReach * half[i];
    camera.intrinsics(i, 2) = (pinhole.principal[i] / kReach + 1) * half[i];
  }
  camera.world_from_camera.linear() = pinhole.rotation;
  camera.world_from_camera.translation() = robust_centre(rays, recovered.origin_error);
  return recovered;
}

RayMap rays_of_camera(const Camera& camera, int64_t map_width, int64_t map_height) {
  RayMap map(map_width, map_height);
  const Eigen::Matrix3d direction_from_pixel =
      camera.world_from_camera.linear() * camera.intrinsics.inverse();
  const Eigen::Vector3d centre = camera.world_from_camera.translation();
  for (int64_t y = 0; y < map_height; ++y) {
    for (int64_t x = 0; x < map_width; ++x) {
      const double u =
          (static_cast<double>(x) + 0.5) * static_cast<double>(camera.width) / static_cast<double>(map_width);
      const double v = (static_cast<double>(y) + 0.5) * static_cast<double>(camera.height) /
                       static_cast<double>(map_height);
      const Eigen::Vector3d direction = direction_from_pixel * Eigen::Vector3d(u, v, 1);
      for (int i = 0; i < 3; ++i) {
        map.ray(x, y)[i] = static_cast<float>(direction[i]);
        map.ray(x, y)[3 + i] = static_cast<float>(centre[i]);
      }
    }
  }
  return map;
}

}  // namespace gld
