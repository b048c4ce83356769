#pragma once

#include "datasets/synthetic/synthetic_material.h"

#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace gld {

// The geometry of a generated scene: a room with solid objects in it. World axes: z up, the floor at z = 0, metres.

enum class Shape { kBox, kSphere, kCylinder };

struct Solid {
  Shape shape = Shape::kBox;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d half_size =
      Eigen::Vector3d::Ones();  // sphere: radius in x; cylinder: radius in x, half height in z
  double turn = 0;              // radians about the vertical axis
  Material material;

  double bounding_radius() const;
};

// A picture or a lamp panel flat on a face of the room.
struct Decal {
  int face = 0;                                   // as Room::faces
  Eigen::Vector2d low = Eigen::Vector2d::Zero();  // surface coordinates of the face
  Eigen::Vector2d high = Eigen::Vector2d::Zero();
  Material material;
  double glow = 0;  // light given off, as a multiple of white
};

// The space between |x| <= half_x, |y| <= half_y, 0 <= z <= height.
// Faces: 0 x low, 1 x high, 2 y low, 3 y high, 4 floor, 5 ceiling.
// Surface coordinates: walls (along the wall, height), floor and ceiling (x, y).
struct Room {  // NOLINT(bugprone-reserved-identifier): clang's own copy of the array has such a name
  double half_x = 2;
  double half_y = 2;
  double height = 2.7;
  Material faces[6];
};

// A round lamp seen as a disc from every direction.
struct Lamp {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double radius = 0.3;                              // metres; sets the softness of shadows
  Eigen::Vector3d power = Eigen::Vector3d::Ones();  // irradiance at one metre, linear RGB
};

// A lamp's light is divided by this at that distance. It is gentler than the square law: without light bouncing off
// walls, that would leave them black.
double light_loss(double distance);

struct SyntheticWorld {
  Room room;
  std::vector<Solid> solids;
  std::vector<Decal> decals;
  std::vector<Lamp> lamps;
  Eigen::Vector3d ambient = Eigen::Vector3d::Constant(0.3);
};

struct Ray {
  Eigen::Vector3d origin;
  Eigen::Vector3d direction;  // any length; distances count in it
};

struct Hit {
  double distance = 0;  // in lengths of the ray's direction
  int surface = 0;      // distinct for every face of every solid; equal surfaces are one smooth patch
  int solid = -1;       // index, or -1 for the room
  int room_face = 0;    // where solid is -1
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // towards the ray's side
  double u = 0;                                       // surface coordinates, metres
  double v = 0;
};

// Returns a vector turned about the vertical axis by the angle of that cosine and sine.
Eigen::Vector3d turned_by(const Eigen::Vector3d& v, double cosine, double sine);

// Returns the distance from a point to the nearest solid or face of the room; negative inside a solid or outside the
// room.
double clearance(const SyntheticWorld& world, const Eigen::Vector3d& point);

}  // namespace gld
