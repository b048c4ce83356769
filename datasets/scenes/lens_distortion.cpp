#include "datasets/scenes/lens_distortion.h"

#include <cmath>

namespace gld {
namespace {

Eigen::Vector2d tangential(const LensDistortion& lens, const Eigen::Vector2d& p) {
  const double r2 = p.squaredNorm();
  const double xy = p.x() * p.y();
  return {2 * lens.p1 * xy + lens.p2 * (r2 + 2 * p.x() * p.x()),
          2 * lens.p2 * xy + lens.p1 * (r2 + 2 * p.y() * p.y())};
}

// Returns the direction of the point with the angle from the optical axis as its length.
Eigen::Vector2d by_angle(const Eigen::Vector2d& p) {
  const double radius = p.norm();
  return radius < 1e-12 ? p : Eigen::Vector2d(p * (std::atan(radius) / radius));
}

}  // namespace

bool LensDistortion::ideal() const {
  if (model == LensModel::kNone) return true;
  return model == LensModel::kRadialTangential && k1 == 0 && k2 == 0 && k3 == 0 && k4 == 0 && k5 == 0 &&
         k6 == 0 && p1 == 0 && p2 == 0;
}

bool LensDistortion::finite() const {
  return std::isfinite(k1 + k2 + k3 + k4 + k5 + k6) && std::isfinite(p1 + p2 + sx1 + sy1);
}

Eigen::Vector2d distorted(const LensDistortion& lens, const Eigen::Vector2d& p) {
  switch (lens.model) {
    case LensModel::kNone:
      return p;
    case LensModel::kRadialTangential: {
      const double r2 = p.squaredNorm();
      const double up = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3));
      const double down = 1 + r2 * (lens.k4 + r2 * (lens.k5 + r2 * lens.k6));
      return p * (up / down) + tangential(lens, p);
    }
    case LensModel::kFisheye: {
      const Eigen::Vector2d q = by_angle(p);
      const double t2 = q.squaredNorm();
      return q * (1 + t2 * (lens.k1 + t2 * (lens.k2 + t2 * (lens.k3 + t2 * lens.k4))));
    }
    case LensModel::kThinPrismFisheye: {
      const Eigen::Vector2d q = by_angle(p);
      const double r2 = q.squaredNorm();
      const double radial = r2 * (lens.k1 + r2 * (lens.k2 + r2 * (lens.k3 + r2 * lens.k4)));
      return q + q * radial + tangential(lens, q) + Eigen::Vector2d(lens.sx1 * r2, lens.sy1 * r2);
    }
  }
  return p;
}

double largest_ideal_radius(const LensDistortion& lens) {
  constexpr double kLimit = 100;
  LensDistortion radial = lens;  // the small tangential part does not decide about folding
  radial.p1 = radial.p2 = radial.sx1 = radial.sy1 = 0;
  double before = 0;
  for (double radius = 0.01; radius < kLimit; radius *= 1.01) {
    const double now = distorted(radial, {radius, 0}).x();
    if (!(now > before)) return radius / 1.01;
    before = now;
  }
  return kLimit;
}

}  // namespace gld
