#pragma once

#include "datasets/scenes/seeded_random.h"
#include "datasets/synthetic/synthetic_world.h"
#include "gld/cameras/camera.h"

#include <cstdint>
#include <vector>

namespace gld {

struct ObjectCount {
  int64_t minimum = 3;
  int64_t maximum = 8;
};

// Draws a furnished room: textured walls with pictures, one or two lamps, and that many things (boxes, balls, columns,
// tables, stacks) standing on the floor without touching each other.
SyntheticWorld draw_world(SeededRandom& random, const ObjectCount& objects);

// Makes a world of draw_world less tidy: chairs, sofas, shelves, floor lamps and plants beside what stands there
// already, some surfaces glossy and some dark.
void vary_world(SeededRandom& random, SyntheticWorld& world);

// How a hand holds the camera: slow sways about the smooth path, their largest sizes.
struct HandHeld {
  double sway = 0;  // metres, of the eye
  double aim = 0;   // degrees, of the viewing direction
  double roll = 0;  // degrees about the viewing direction
};

struct PathDraw {
  int64_t frames = 24;
  int64_t width = 112;
  int64_t height = 112;
  double field_of_view_low = 50;   // degrees, across the larger side
  double field_of_view_high = 75;  // degrees
  HandHeld hand;
};

// Draws a smooth camera path through the free space of the room that looks at its middle: an arc around it, a walk
// towards it, or a walk past it. Neighbours see mostly the same things. It stays at least 0.3 m from everything.
std::vector<Camera> draw_camera_path(SeededRandom& random, const SyntheticWorld& world, const PathDraw& path);

// Returns a camera at eye that looks at target, upright in a world whose z axis points up.
Eigen::Isometry3d look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target);

}  // namespace gld
