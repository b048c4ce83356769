#include "datasets/synthetic/ray_tracer.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gld {
namespace {

using Eigen::Vector3d;

constexpr double kNear = 1e-6;
constexpr double kFar = std::numeric_limits<double>::infinity();

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

// Faces are 0 the mantle, 4 the bottom, 5 the top.
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

// A ray in the axes of a solid.
struct LocalRay {
  Vector3d origin;
  Vector3d direction;
};

Vector3d in_axes(const TracedSolid& traced, const Vector3d& v) {
  return traced.solid->turn == 0 ? v : turned_by(v, traced.cosine, -traced.sine);
}

LocalRay in_solid(const TracedSolid& traced, const Ray& ray) {
  return {in_axes(traced, ray.origin - traced.solid->centre), in_axes(traced, ray.direction)};
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

// Returns whether the line through a point in a direction comes near enough to a solid, whose centre is at `offset`
// from the point, to be worth a closer look.
bool near_line(const TracedSolid& traced, const Vector3d& offset, double offset2, const Vector3d& direction,
               double length2) {
  const double along = offset.dot(direction);
  return offset2 * length2 - along * along <= traced.radius2 * length2;
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

void describe_solid_hit(const TracedSolid& traced, const LocalRay& ray, int face, Hit& hit) {
  const Solid& solid = *traced.solid;
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
  hit.normal = turned_by(normal, traced.cosine, traced.sine);
}

}  // namespace

RayTracer::RayTracer(const SyntheticWorld& world) : world_(world) {
  for (const Solid& solid : world.solids) {
    const double radius = solid.bounding_radius();
    solids_.push_back({&solid, std::cos(solid.turn), std::sin(solid.turn), radius, radius * radius});
  }
}

Hit RayTracer::first_hit(const Ray& ray) const {
  Hit hit = room_hit(world_.room, ray);
  const double length2 = ray.direction.squaredNorm();
  int face = 0;
  for (size_t i = 0; i < solids_.size(); ++i) {
    const Vector3d offset = solids_[i].solid->centre - ray.origin;
    if (!near_line(solids_[i], offset, offset.squaredNorm(), ray.direction, length2)) continue;
    const Entry entry = enter(*solids_[i].solid, in_solid(solids_[i], ray));
    if (entry.distance >= hit.distance) continue;
    hit.distance = entry.distance;
    hit.solid = static_cast<int>(i);
    face = entry.face;
  }
  if (hit.solid >= 0) {
    const TracedSolid& traced = solids_[static_cast<size_t>(hit.solid)];
    hit.surface = 6 + 6 * hit.solid + face;
    hit.point = ray.origin + hit.distance * ray.direction;
    describe_solid_hit(traced, in_solid(traced, ray), face, hit);
  }
  return hit;
}

ShadowRays::ShadowRays(const RayTracer& tracer, const Vector3d& start, int own_solid, const Vector3d& segment,
                       double spread) {
  const double length2 = segment.squaredNorm();
  const std::vector<TracedSolid>& solids = tracer.solids();
  for (size_t i = 0; i < solids.size() && count_ < blockers_.size(); ++i) {
    if (static_cast<int>(i) == own_solid) continue;
    const TracedSolid& traced = solids[i];
    const Vector3d offset = traced.solid->centre - start;
    const double along = std::clamp(offset.dot(segment) / length2, 0.0, 1.0);
    const double reach = traced.radius + spread * along;
    if ((offset - along * segment).squaredNorm() >= reach * reach) continue;
    blockers_[count_++] = {&traced, offset, offset.squaredNorm(),
                           in_axes(traced, start - traced.solid->centre)};
  }
}

bool ShadowRays::blocked(const Vector3d& direction) {
  const double length2 = direction.squaredNorm();
  for (size_t i = 0; i < count_; ++i) {
    const Blocker& blocker = blockers_[i];
    if (!near_line(*blocker.traced, blocker.offset, blocker.offset2, direction, length2)) continue;
    const LocalRay local{blocker.local_start, in_axes(*blocker.traced, direction)};
    if (enter(*blocker.traced->solid, local).distance < 1) {
      std::swap(blockers_[0], blockers_[i]);  // the next ray of the bundle is likely to meet it too
      return true;
    }
  }
  return false;
}

}  // namespace gld
