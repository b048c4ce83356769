#include "datasets/synthetic/synthetic_world.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gld {

double Solid::bounding_radius() const {
  switch (shape) {
    case Shape::kSphere:
      return half_size.x();
    case Shape::kCylinder:
      return std::hypot(half_size.x(), half_size.z());
    case Shape::kBox:
      break;
  }
  return half_size.norm();
}

Eigen::Vector3d turned_by(const Eigen::Vector3d& v, double cosine, double sine) {
  return {cosine * v.x() - sine * v.y(), sine * v.x() + cosine * v.y(), v.z()};
}

double light_loss(double distance) { return 1 + 0.18 * distance * distance; }

double clearance(const SyntheticWorld& world, const Eigen::Vector3d& point) {
  const Room& room = world.room;
  double nearest = std::min({room.half_x - std::abs(point.x()), room.half_y - std::abs(point.y()), point.z(),
                             room.height - point.z()});
  for (const Solid& solid : world.solids) {
    const Eigen::Vector3d offset = point - solid.centre;
    const Eigen::Vector3d p =
        solid.turn == 0 ? offset : turned_by(offset, std::cos(solid.turn), -std::sin(solid.turn));
    double distance = 0;
    if (solid.shape == Shape::kSphere) {
      distance = p.norm() - solid.half_size.x();
    } else {
      Eigen::Vector3d outside = p.cwiseAbs() - solid.half_size;
      if (solid.shape == Shape::kCylinder) {
        outside = Eigen::Vector3d(std::hypot(p.x(), p.y()) - solid.half_size.x(),
                                  -std::numeric_limits<double>::infinity(), outside.z());
      }
      distance = outside.cwiseMax(0).norm() + std::min(outside.maxCoeff(), 0.0);
    }
    nearest = std::min(nearest, distance);
  }
  return nearest;
}

}  // namespace gld
