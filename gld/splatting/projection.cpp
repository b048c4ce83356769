#include "gld/splatting/projection.h"

#include "gld/splatting/spherical_harmonics.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

namespace gld {
namespace {

// So far beyond the picture's edge, in half its sides, the Jacobian still follows a Gaussian.
constexpr double kBeyondTheEdge = 0.3;

double sigmoid(double x) { return 1 / (1 + std::exp(-x)); }

Eigen::Matrix3d rotation_of(const Eigen::Vector4d& unit) {
  const double w = unit[0], x = unit[1], y = unit[2], z = unit[3];
  Eigen::Matrix3d r;
  r << 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),  //
      2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),   //
      2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y);
  return r;
}

// Returns d loss / d unit quaternion from d loss / d rotation.
Eigen::Vector4d rotation_backward(const Eigen::Vector4d& unit, const Eigen::Matrix3d& g) {
  const double w = unit[0], x = unit[1], y = unit[2], z = unit[3];
  return 2 * Eigen::Vector4d(x * (g(2, 1) - g(1, 2)) + y * (g(0, 2) - g(2, 0)) + z * (g(1, 0) - g(0, 1)),
                             w * (g(2, 1) - g(1, 2)) - 2 * x * (g(1, 1) + g(2, 2)) + y * (g(0, 1) + g(1, 0)) +
                                 z * (g(0, 2) + g(2, 0)),
                             w * (g(0, 2) - g(2, 0)) + x * (g(0, 1) + g(1, 0)) - 2 * y * (g(0, 0) + g(2, 2)) +
                                 z * (g(1, 2) + g(2, 1)),
                             w * (g(1, 0) - g(0, 1)) + x * (g(0, 2) + g(2, 0)) + y * (g(1, 2) + g(2, 1)) -
                                 2 * z * (g(0, 0) + g(1, 1)));
}

struct Jacobian {
  double held[2];  // x/z and y/z as they enter the Jacobian
  bool is_held[2];
};

Jacobian jacobian_of(const Eigen::Vector3d& t, const SplatCamera& camera) {
  Jacobian result;
  for (int axis = 0; axis < 2; ++axis) {
    const double ratio = t[axis] / t[2];
    result.held[axis] = std::clamp(ratio, camera.low[axis], camera.high[axis]);
    result.is_held[axis] = result.held[axis] != ratio;
  }
  return result;
}

// Returns J R_cw: row a is focal_a / z (row a of R_cw - held_a row 2 of R_cw).
Eigen::Matrix<double, 2, 3> picture_from_world(const Eigen::Vector3d& t, const Jacobian& jacobian,
                                               const SplatCamera& camera) {
  const Eigen::Matrix3d& r = camera.camera_from_world_rotation;
  Eigen::Matrix<double, 2, 3> n;
  for (int axis = 0; axis < 2; ++axis)
    n.row(axis) = camera.focal[axis] / t[2] * (r.row(axis) - jacobian.held[axis] * r.row(2));
  return n;
}

}  // namespace

void ProjectionOptions::visit(FieldVisitor& visitor) {
  visitor.real(
      {"near", "nearest depth that is drawn, in the unit of the poses; 0: 0.01 of the scene's extent"}, near,
      {0, 1e30});
  visitor.boolean({"antialias", "Gaussians smaller than a pixel become fainter, not larger (Mip-Splatting)"},
                  antialias);
  visitor.real({"least_alpha", "alpha from which a Gaussian reaches a pixel"}, least_alpha, {1e-9, 0.5});
  visitor.real({"least_transmittance", "what has to be left of a pixel behind a Gaussian for it to be drawn"},
               least_transmittance, {1e-9, 0.5});
}

SplatCamera splat_camera(const Camera& camera, const Eigen::Vector3d& origin,
                         const ProjectionOptions& options) {
  SplatCamera result;
  result.width = camera.width;
  result.height = camera.height;
  const double sides[2] = {static_cast<double>(camera.width), static_cast<double>(camera.height)};
  for (int axis = 0; axis < 2; ++axis) {
    result.focal[axis] = camera.intrinsics(axis, axis);
    result.principal[axis] = camera.intrinsics(axis, 2);
    const double beyond = kBeyondTheEdge * 0.5 * sides[axis];
    result.low[axis] = (-result.principal[axis] - beyond) / result.focal[axis];
    result.high[axis] = (sides[axis] - result.principal[axis] + beyond) / result.focal[axis];
  }
  result.camera_from_world_rotation = camera.world_from_camera.linear().transpose();
  result.offset = origin - camera.world_from_camera.translation();
  result.near = options.near;
  result.antialias = options.antialias;
  result.least_alpha = options.least_alpha;
  result.least_alpha_power = static_cast<float>(std::log2(options.least_alpha));
  result.least_transmittance = static_cast<float>(options.least_transmittance);
  return result;
}

GaussianShape gaussian_shape(const GaussianSet& set, int64_t i) {
  GaussianShape shape;
  for (int k = 0; k < 3; ++k) {
    shape.mean[k] = set.means[static_cast<size_t>(3 * i + k)];
    shape.log_scale[k] = set.log_scales[static_cast<size_t>(3 * i + k)];
  }
  for (int k = 0; k < 4; ++k) shape.rotation[k] = set.rotations[static_cast<size_t>(4 * i + k)];
  shape.logit_opacity = set.logit_opacities[static_cast<size_t>(i)];
  return shape;
}

bool project_gaussian(const GaussianShape& shape, const SplatCamera& camera, ProjectedGaussian& projected) {
  projected.from_camera = shape.mean + camera.offset;
  const Eigen::Vector3d t = camera.camera_from_world_rotation * projected.from_camera;
  if (!(t[2] > camera.near)) return false;
  projected.opacity = sigmoid(shape.logit_opacity);
  if (projected.opacity < camera.least_alpha) return false;
  projected.x_in_camera = t;
  for (int axis = 0; axis < 2; ++axis)
    projected.mean[axis] = camera.focal[axis] * t[axis] / t[2] + camera.principal[axis];
  const Eigen::Matrix3d axes =
      rotation_of(shape.rotation.normalized()) * shape.log_scale.array().exp().matrix().asDiagonal();
  const Eigen::Matrix<double, 2, 3> m = picture_from_world(t, jacobian_of(t, camera), camera) * axes;
  projected.projected_axes = m;
  const double xx = m.row(0).squaredNorm(), yy = m.row(1).squaredNorm();
  projected.covariance[0] = xx + kPixelVariance;
  projected.covariance[1] = m.row(0).dot(m.row(1));
  projected.covariance[2] = yy + kPixelVariance;
  const double a = m(0, 0) * m(1, 1) - m(0, 1) * m(1, 0), b = m(0, 0) * m(1, 2) - m(0, 2) * m(1, 0),
               c = m(0, 1) * m(1, 2) - m(0, 2) * m(1, 1);
  projected.plain_determinant = a * a + b * b + c * c;
  projected.determinant =
      projected.plain_determinant + kPixelVariance * (xx + yy) + kPixelVariance * kPixelVariance;
  if (!std::isfinite(projected.determinant) || !projected.mean.allFinite()) return false;
  if (camera.antialias) projected.opacity *= std::sqrt(projected.plain_determinant / projected.determinant);
  return projected.opacity >= camera.least_alpha;
}

void project_gaussian_backward(const GaussianShape& shape, const SplatCamera& camera,
                               const ProjectedGaussian& projected, const ProjectedGradient& of_projected,
                               GaussianShape& gradient) {
  const Eigen::Matrix3d& r = camera.camera_from_world_rotation;
  const Eigen::Vector3d& t = projected.x_in_camera;
  const Eigen::Matrix<double, 2, 3>& m = projected.projected_axes;
  Eigen::Matrix2d of_covariance;
  of_covariance << of_projected.covariance[0], of_projected.covariance[1], of_projected.covariance[1],
      of_projected.covariance[2];
  Eigen::Matrix<double, 2, 3> of_m = 2 * of_covariance * m;
  if (camera.antialias && projected.plain_determinant > 0) {
    // The log of the opacity's factor is (log det M M^T - log det S2) / 2.
    const double xx = m.row(0).squaredNorm(), yy = m.row(1).squaredNorm(), xy = m.row(0).dot(m.row(1));
    Eigen::Matrix<double, 2, 3> of_plain;
    of_plain.row(0) = 2 * (yy * m.row(0) - xy * m.row(1));
    of_plain.row(1) = 2 * (xx * m.row(1) - xy * m.row(0));
    of_m += 0.5 * of_projected.log_opacity *
            (of_plain / projected.plain_determinant -
             (of_plain + 2 * kPixelVariance * m) / projected.determinant);
  }
  gradient.logit_opacity = of_projected.log_opacity * sigmoid(-shape.logit_opacity);
  const Jacobian jacobian = jacobian_of(t, camera);
  const Eigen::Matrix<double, 2, 3> n = picture_from_world(t, jacobian, camera);
  const double length = shape.rotation.norm();
  const Eigen::Vector4d unit = shape.rotation / length;
  const Eigen::Matrix3d rotation = rotation_of(unit);
  const Eigen::Vector3d scale = shape.log_scale.array().exp();
  for (int k = 0; k < 3; ++k) gradient.log_scale[k] = of_m.col(k).dot(m.col(k));
  const Eigen::Matrix<double, 2, 3> scaled = of_m * scale.asDiagonal();
  const Eigen::Vector4d of_unit = rotation_backward(unit, n.transpose() * scaled);
  gradient.rotation = (of_unit - unit * unit.dot(of_unit)) / length;
  const Eigen::Matrix<double, 2, 3> of_n = scaled * rotation.transpose();
  Eigen::Vector3d of_t = Eigen::Vector3d::Zero();
  for (int axis = 0; axis < 2; ++axis) {
    const double over_z = camera.focal[axis] / t[2], ratio = t[axis] / t[2];
    const double of_held = -over_z * of_n.row(axis).dot(r.row(2));
    of_t[2] -= of_n.row(axis).dot(n.row(axis)) / t[2];
    const double of_ratio =
        (jacobian.is_held[axis] ? 0 : of_held) + camera.focal[axis] * of_projected.mean[axis];
    of_t[axis] += of_ratio / t[2];
    of_t[2] -= of_ratio * ratio / t[2];
  }
  gradient.mean = r.transpose() * of_t + of_projected.direction_mean;
}

void seen_colour(const GaussianSet& set, int64_t i, const Eigen::Vector3d& from_camera, SeenColour& colour) {
  colour.distance = from_camera.norm();
  colour.direction = from_camera / colour.distance;
  spherical_harmonics(set.degree, colour.direction.data(), colour.harmonics);
  const int64_t others = harmonic_coefficients(set.degree) - 1;
  const float* first = set.colours.data() + 3 * i;
  const float* rest = set.harmonics.data() + 3 * others * i;
  // It takes two coefficients, of three channels each, at a time: these are vectors without a stride.
  double sums[6] = {};
  int64_t k = 0;
  for (; k + 2 <= others; k += 2) {
    const double a = colour.harmonics[k + 1], b = colour.harmonics[k + 2];
    const double harmonics[6] = {a, a, a, b, b, b};
    for (int n = 0; n < 6; ++n) sums[n] += harmonics[n] * static_cast<double>(rest[3 * k + n]);
  }
  for (int c = 0; c < 3; ++c) {
    if (k < others) sums[c] += colour.harmonics[k + 1] * static_cast<double>(rest[3 * k + c]);
    colour.rgb[c] = std::max(0.0, kHarmonicGrey + colour.harmonics[0] * first[c] + sums[c] + sums[c + 3]);
  }
}

Eigen::Vector3d seen_colour_backward(const GaussianSet& set, int64_t i, const SeenColour& colour,
                                     const double of_rgb[3], GaussianSet& gradients) {
  const int64_t others = harmonic_coefficients(set.degree) - 1;
  double of_sum[3];
  for (int c = 0; c < 3; ++c) {
    of_sum[c] = colour.rgb[c] > 0 ? of_rgb[c] : 0;
    gradients.colours[static_cast<size_t>(3 * i + c)] += static_cast<float>(colour.harmonics[0] * of_sum[c]);
  }
  if (others == 0) return Eigen::Vector3d::Zero();
  const float* rest = set.harmonics.data() + 3 * others * i;
  float* of_rest = gradients.harmonics.data() + 3 * others * i;
  double slopes[kMostHarmonicCoefficients][3];
  spherical_harmonic_slopes(set.degree, colour.direction.data(), slopes);
  Eigen::Vector3d of_direction = Eigen::Vector3d::Zero();
  for (int64_t k = 0; k < others; ++k) {
    double along = 0;
    for (int c = 0; c < 3; ++c) {
      of_rest[3 * k + c] += static_cast<float>(colour.harmonics[k + 1] * of_sum[c]);
      along += rest[3 * k + c] * of_sum[c];
    }
    for (int axis = 0; axis < 3; ++axis) of_direction[axis] += along * slopes[k + 1][axis];
  }
  return (of_direction - colour.direction * colour.direction.dot(of_direction)) / colour.distance;
}

}  // namespace gld
