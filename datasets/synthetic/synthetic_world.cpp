#include "datasets/synthetic/synthetic_world.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gld {
namespace {

using Eigen::Vector3d;

constexpr double kNear = 1e-6;
constexpr double kFar = std::numeric_limits<double>::infinity();

Vector3d turned(const Vector3d& v, double cosine, double sine) {
  return {cosine * v.x() - sine * v.y(), sine * v.x() + cosine * v.y(), v.z()};
}

// Distance and face (2 * axis + side) of the entry into the box |x| <= half, from outside.
struct Entry {
  double distance = kFar;
  int face = 0;
};

Entry enter_box(const Vector3d& origin, const Vector3d& direction, const Vector3d& half) {
  double near = -kFar;
  double far = kFar;
  int face = 0;
  for (int axis = 0; axis < 3; ++axis) {
    if (direction[axis] == 0) {
      if (std::abs(origin[axis]) > half[axis]) return {};
      continue;
    }
    const double inverse = 1 / direction[axis];
    const double side = direction[axis] > 0 ? -half[axis] : half[axis];
    const double in = (side - origin[axis]) * inverse;
    const double out = (-side - origin[axis]) * inverse;
    if (in > near) {
      near = in;
      face = 2 * axis + (direction[axis] > 0 ? 0 : 1);
    }
    far = std::min(far, out);
  }
  if (near > far || near < kNear) return {};
  return {near, face};
}

Entry enter_sphere(const Vector3d& origin, const Vector3d& direction, double radius) {
  const double a = direction.squaredNorm();
  const double b = origin.dot(direction);
  const double c = origin.squaredNorm() - radius * radius;
  const double discriminant = b * b - a * c;
  if (discriminant < 0) return {};
  const double distance = (-b - std::sqrt(discriminant)) / a;
  return distance > kNear ? Entry{distance, 0} : Entry{};
}

// Faces: 0 the mantle, 4 the bottom, 5 the top.
Entry enter_cylinder(const Vector3d& origin, const Vector3d& direction, double radius, double half_height) {
  Entry best;
  const double a = direction.x() * direction.x() + direction.y() * direction.y();
  const double b = origin.x() * direction.x() + origin.y() * direction.y();
  const double c = origin.x() * origin.x() + origin.y() * origin.y() - radius * radius;
  const double discriminant = b * b - a * c;
  if (a > 0 && discriminant >= 0) {
    const double distance = (-b - std::sqrt(discriminant)) / a;
    if (distance > kNear && std::abs(origin.z() + distance * direction.z()) <= half_height)
      best = {distance, 0};
  }
  if (direction.z() != 0) {
    const double cap = direction.z() > 0 ? -half_height : half_height;
    const double distance = (cap - origin.z()) / direction.z();
    const double x = origin.x() + distance * direction.x();
    const double y = origin.y() + distance * direction.y();
    if (distance > kNear && distance < best.distance && x * x + y * y <= radius * radius) {
      best = {distance, direction.z() > 0 ? 4 : 5};
    }
  }
  return best;
}

struct LocalRay {
  Vector3d origin;
  Vector3d direction;
};

LocalRay in_solid(const Solid& solid, const Ray& ray) {
  const Vector3d offset = ray.origin - solid.centre;
  if (solid.turn == 0) return {offset, ray.direction};
  const double cosine = std::cos(solid.turn);
  const double sine = std::sin(solid.turn);
  return {turned(offset, cosine, -sine), turned(ray.direction, cosine, -sine)};
}

Entry enter(const Solid& solid, const LocalRay& ray) {
  switch (solid.shape) {
    case Shape::kBox:
      return enter_box(ray.origin, ray.direction, solid.half_size);
    case Shape::kSphere:
      return enter_sphere(ray.origin, ray.direction, solid.half_size.x());
    case Shape::kCylinder:
      return enter_cylinder(ray.origin, ray.direction, solid.half_size.x(), solid.half_size.z());
  }
  return {};
}

// Whether the ray's line comes near enough to the solid to be worth a closer look.
bool near_line(const Solid& solid, const Ray& ray) {
  const Vector3d offset = solid.centre - ray.origin;
  const double along = offset.dot(ray.direction);
  const double radius = solid.bounding_radius();
  const double length2 = ray.direction.squaredNorm();
  return offset.squaredNorm() * length2 - along * along <= radius * radius * length2;
}

Hit room_hit(const Room& room, const Ray& ray) {
  Hit hit;
  hit.distance = kFar;
  const Vector3d low(-room.half_x, -room.half_y, 0);
  const Vector3d high(room.half_x, room.half_y, room.height);
  for (int axis = 0; axis < 3; ++axis) {
    if (ray.direction[axis] == 0) continue;
    const bool up = ray.direction[axis] > 0;
    const double distance = ((up ? high : low)[axis] - ray.origin[axis]) / ray.direction[axis];
    if (distance < hit.distance) {
      hit.distance = distance;
      hit.room_face = 2 * axis + (up ? 1 : 0);
    }
  }
  hit.surface = hit.room_face;
  hit.point = ray.origin + hit.distance * ray.direction;
  hit.normal = Vector3d::Zero();
  hit.normal[hit.room_face / 2] = hit.room_face % 2 == 1 ? -1 : 1;
  const bool level = hit.room_face >= 4;
  hit.u = hit.room_face < 2 ? hit.point.y() : hit.point.x();
  hit.v = level ? hit.point.y() : hit.point.z();
  return hit;
}

void describe_solid_hit(const Solid& solid, const LocalRay& ray, int face, Hit& hit) {
  const Vector3d p = ray.origin + hit.distance * ray.direction;
  Vector3d normal = Vector3d::Zero();
  if (solid.shape == Shape::kSphere) {
    normal = p / solid.half_size.x();
    hit.u = solid.half_size.x() * std::atan2(p.y(), p.x());
    hit.v = solid.half_size.x() * std::asin(std::clamp(normal.z(), -1.0, 1.0));
  } else if (solid.shape == Shape::kCylinder && face == 0) {
    normal = Vector3d(p.x(), p.y(), 0) / solid.half_size.x();
    hit.u = solid.half_size.x() * std::atan2(p.y(), p.x());
    hit.v = p.z();
  } else {
    const int axis = face / 2;
    normal[axis] = face % 2 == 1 ? 1 : -1;
    hit.u = axis == 0 ? p.y() : p.x();
    hit.v = axis == 2 ? p.y() : p.z();
  }
  hit.normal = turned(normal, std::cos(solid.turn), std::sin(solid.turn));
}

}  // namespace

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

Hit first_hit(const SyntheticWorld& world, const Ray& ray) {
  Hit hit = room_hit(world.room, ray);
  int face = 0;
  for (size_t i = 0; i < world.solids.size(); ++i) {
    const Solid& solid = world.solids[i];
    if (!near_line(solid, ray)) continue;
    const Entry entry = enter(solid, in_solid(solid, ray));
    if (entry.distance >= hit.distance) continue;
    hit.distance = entry.distance;
    hit.solid = static_cast<int>(i);
    face = entry.face;
  }
  if (hit.solid >= 0) {
    const Solid& solid = world.solids[static_cast<size_t>(hit.solid)];
    hit.surface = 6 + 6 * hit.solid + face;
    hit.point = ray.origin + hit.distance * ray.direction;
    describe_solid_hit(solid, in_solid(solid, ray), face, hit);
  }
  return hit;
}

bool meets_solid(const Solid& solid, const Ray& segment) {
  return near_line(solid, segment) && enter(solid, in_solid(solid, segment)).distance < 1;
}

double clearance(const SyntheticWorld& world, const Vector3d& point) {
  const Room& room = world.room;
  double nearest = std::min({room.half_x - std::abs(point.x()), room.half_y - std::abs(point.y()), point.z(),
                             room.height - point.z()});
  for (const Solid& solid : world.solids) {
    const Vector3d p = in_solid(solid, {point, Vector3d::UnitX()}).origin;
    double distance = 0;
    if (solid.shape == Shape::kSphere) {
      distance = p.norm() - solid.half_size.x();
    } else {
      Vector3d outside = p.cwiseAbs() - solid.half_size;
      if (solid.shape == Shape::kCylinder) {
        outside = Vector3d(std::hypot(p.x(), p.y()) - solid.half_size.x(), -kFar, outside.z());
      }
      distance = outside.cwiseMax(0).norm() + std::min(outside.maxCoeff(), 0.0);
    }
    nearest = std::min(nearest, distance);
  }
  return nearest;
}

}  // namespace gld
