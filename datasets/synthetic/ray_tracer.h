#pragma once

#include "datasets/synthetic/synthetic_world.h"

#include <array>
#include <cstddef>
#include <vector>

#include <Eigen/Core>

namespace gld {

// A solid with what every ray needs of it.
struct TracedSolid {
  const Solid* solid = nullptr;
  double cosine = 1;  // of its turn
  double sine = 0;
  double radius = 0;  // of the bounding sphere
  double radius2 = 0;
};

// A generated world made ready for rays; it refers to the world, which must outlive it.
class RayTracer {
 public:
  explicit RayTracer(const SyntheticWorld& world);

  // Returns the nearest surface; a ray that starts in the room always meets one.
  Hit first_hit(const Ray& ray) const;

  const SyntheticWorld& world() const { return world_; }
  const std::vector<TracedSolid>& solids() const { return solids_; }  // as in the world

 private:
  const SyntheticWorld& world_;
  std::vector<TracedSolid> solids_;
};

// Rays from one point of a surface to points of a lamp: which solids may stand between is found once for all of them.
class ShadowRays {
 public:
  // segment goes from the start to the lamp's centre; spread is the lamp's radius; own_solid is the one on which the
  // start lies, or -1.
  ShadowRays(const RayTracer& tracer, const Eigen::Vector3d& start, int own_solid,
             const Eigen::Vector3d& segment, double spread);

  bool empty() const { return count_ == 0; }  // nothing can be in the way

  // Returns whether a solid lies between the start and start + direction. Remembers which, so the object changes.
  bool blocked(const Eigen::Vector3d& direction);

 private:
  struct Blocker {
    const TracedSolid* traced;
    Eigen::Vector3d offset;  // from the start to its centre
    double offset2;
    Eigen::Vector3d local_start;  // the start in the solid's axes
  };
  std::array<Blocker, 32>
      blockers_;  // the first count_ are set: most points have none, and there are many points
  size_t count_ = 0;
};

}  // namespace gld
