#include "datasets/synthetic/synthetic_layout.h"

#include "datasets/scenes/frame_checks.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Geometry>

namespace gld {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kPi = 3.14159265358979323846;
constexpr double kLowestClearance = 0.3;  // metres between the camera and anything

// One thing of one or more solids, built around the origin of the floor.
struct Thing {
  std::vector<Solid> solids;
  double radius = 0;  // of its footprint
};

Solid box(const Vector3d& centre, const Vector3d& size, const Material& material) {
  Solid solid;
  solid.centre = centre;
  solid.half_size = 0.5 * size;
  solid.material = material;
  return solid;
}

Solid sphere(const Vector3d& centre, double radius, const Material& material) {
  Solid solid;
  solid.shape = Shape::kSphere;
  solid.centre = centre;
  solid.half_size = Vector3d::Constant(radius);
  solid.material = material;
  return solid;
}

Solid cylinder(const Vector3d& bottom, double radius, double height, const Material& material) {
  Solid solid;
  solid.shape = Shape::kCylinder;
  solid.centre = bottom + Vector3d(0, 0, 0.5 * height);
  solid.half_size = {radius, radius, 0.5 * height};
  solid.material = material;
  return solid;
}

// Several draws of one call are drawn from the last to the first; synthetic_material.cpp says why.
Vector3d draw_size(SeededRandom& random, const DrawRange& x, const DrawRange& y, const DrawRange& z) {
  const double height = z.draw(random), depth = y.draw(random), width = x.draw(random);
  return {width, depth, height};
}

Thing draw_table(SeededRandom& random) {
  Thing table;
  const Vector3d size = draw_size(random, {0.8, 1.4}, {0.6, 0.9}, {0.6, 0.8});
  const Material wood = draw_object(random);
  Material legs = wood;
  legs.pattern = Pattern::kPlain;
  legs.first = 0.6 * wood.first;
  table.solids.push_back(box({0, 0, size.z() - 0.04}, {size.x(), size.y(), 0.08}, wood));
  for (double x : {-0.42, 0.42}) {
    for (double y : {-0.40, 0.40}) {
      table.solids.push_back(
          box({x * size.x(), y * size.y(), 0.5 * size.z() - 0.04}, {0.08, 0.08, size.z() - 0.08}, legs));
    }
  }
  const double radius = random.uniform(0.1, 0.2);
  if (random.chance(0.7)) {
    const Material ball = draw_object(random);
    table.solids.push_back(
        sphere({random.uniform(-0.2, 0.2), random.uniform(-0.1, 0.1), size.z() + radius}, radius, ball));
  }
  table.radius = 0.5 * std::hypot(size.x(), size.y());
  return table;
}

Thing draw_stack(SeededRandom& random) {
  Thing stack;
  double width = random.uniform(0.5, 0.9);
  double top = 0;
  stack.radius = 0.72 * width;
  const int64_t floors = random.integer(2, 3);
  for (int64_t i = 0; i < floors; ++i) {
    const double height = random.uniform(0.25, 0.5);
    const Material material = draw_object(random);
    Solid block =
        box({0, 0, top + 0.5 * height}, {width, width * random.uniform(0.7, 1.0), height}, material);
    block.turn = random.uniform(-0.3, 0.3);
    stack.solids.push_back(block);
    top += height;
    width *= 0.7;
  }
  if (random.chance(0.5)) {
    const double radius = 0.5 * width;
    stack.solids.push_back(sphere({0, 0, top + radius}, radius, draw_object(random)));
  }
  return stack;
}

Thing draw_thing(SeededRandom& random) {
  Thing thing;
  const double kind = random.uniform();
  if (kind < 0.28) {
    const Vector3d size = draw_size(random, {0.4, 1.0}, {0.4, 0.8}, {0.4, 1.3});
    thing.solids.push_back(box({0, 0, 0.5 * size.z()}, size, draw_object(random)));
    thing.radius = 0.5 * std::hypot(size.x(), size.y());
  } else if (kind < 0.50) {
    thing.radius = random.uniform(0.22, 0.5);
    thing.solids.push_back(sphere({0, 0, thing.radius}, thing.radius, draw_object(random)));
  } else if (kind < 0.68) {
    thing.radius = random.uniform(0.16, 0.4);
    const double height = random.uniform(0.4, 1.4);
    thing.solids.push_back(cylinder({0, 0, 0}, thing.radius, height, draw_object(random)));
    if (random.chance(0.4)) {
      thing.solids.push_back(
          sphere({0, 0, height + 0.8 * thing.radius}, 0.8 * thing.radius, draw_object(random)));
    }
  } else if (kind < 0.84) {
    thing = draw_table(random);
  } else {
    thing = draw_stack(random);
  }
  return thing;
}

void place(Thing& thing, const Vector2d& position, double turn) {
  for (Solid& solid : thing.solids) {
    const double x = std::cos(turn) * solid.centre.x() - std::sin(turn) * solid.centre.y();
    const double y = std::sin(turn) * solid.centre.x() + std::cos(turn) * solid.centre.y();
    solid.centre.x() = position.x() + x;
    solid.centre.y() = position.y() + y;
    solid.turn += turn;
  }
}

// Draws it within those reaches of the middle.
Vector2d draw_position(SeededRandom& random, const Vector2d& reach) {
  const double y = random.uniform(-reach.y(), reach.y()), x = random.uniform(-reach.x(), reach.x());
  return {x, y};
}

void furnish(SeededRandom& random, const ObjectCount& objects, SyntheticWorld& world) {
  struct Footprint {
    Vector2d centre;
    double radius;
  };
  std::vector<Footprint> taken;
  const int64_t wanted = random.integer(objects.minimum, objects.maximum);
  for (int64_t attempt = 0; attempt < 40 * wanted && static_cast<int64_t>(taken.size()) < wanted; ++attempt) {
    Thing thing = draw_thing(random);
    const double margin = thing.radius + 0.05;
    const double spread = random.chance(0.65) ? 0.6 : 0.98;  // most things stand in the middle of the room
    const double reach_x = std::min(spread * world.room.half_x, world.room.half_x - margin);
    const double reach_y = std::min(spread * world.room.half_y, world.room.half_y - margin);
    const Vector2d centre = draw_position(random, {reach_x, reach_y});
    const double turn = random.uniform(0, 2 * kPi);
    const bool free = std::none_of(taken.begin(), taken.end(), [&](const Footprint& other) {
      return (other.centre - centre).norm() < other.radius + margin;
    });
    if (!free) continue;
    taken.push_back({centre, thing.radius});
    place(thing, centre, turn);
    world.solids.insert(world.solids.end(), thing.solids.begin(), thing.solids.end());
  }
}

void hang_pictures(SeededRandom& random, SyntheticWorld& world) {
  for (int face = 0; face < 4; ++face) {
    const double half = face < 2 ? world.room.half_y : world.room.half_x;
    const int64_t count = random.integer(0, 2);
    for (int64_t i = 0; i < count; ++i) {
      Decal picture;
      picture.face = face;
      const double height = random.uniform(0.6, 1.0), width = random.uniform(0.7, 1.3);
      const Vector2d size(width, height);
      // Each picture keeps to its own part of the wall.
      const double part = 2 * half / static_cast<double>(count);
      const double middle = -half + part * (static_cast<double>(i) + random.uniform(0.4, 0.6));
      const double bottom = random.uniform(0.9, std::max(0.95, world.room.height - size.y() - 0.3));
      if (part < size.x() + 0.4) continue;
      picture.low = {middle - 0.5 * size.x(), bottom};
      picture.high = picture.low + size;
      picture.material = draw_painting(random);
      world.decals.push_back(picture);
    }
  }
}

void light_up(SeededRandom& random, SyntheticWorld& world) {
  const int64_t count = random.integer(1, 2);
  const double warmth = random.uniform(-0.08, 0.14);
  const Vector3d tint(1 + warmth, 1, 1 - warmth);
  for (int64_t i = 0; i < count; ++i) {
    Lamp lamp;
    lamp.centre = {random.uniform(-0.6, 0.6) * world.room.half_x,
                   random.uniform(-0.6, 0.6) * world.room.half_y, world.room.height - 0.05};
    lamp.radius = random.uniform(0.18, 0.4);
    lamp.power = tint * (random.uniform(1.15, 1.5) / static_cast<double>(count));
    world.lamps.push_back(lamp);
    Decal panel;
    panel.face = 5;
    const Vector2d middle = lamp.centre.head<2>();
    panel.low = middle - Vector2d::Constant(lamp.radius);
    panel.high = middle + Vector2d::Constant(lamp.radius);
    panel.material.first = tint.cwiseMin(1);
    panel.glow = 1.6;
    world.decals.push_back(panel);
  }
  world.ambient = tint.cwiseInverse() * random.uniform(0.34, 0.48);
}

double smooth(double t) { return t * t * (3 - 2 * t); }

Thing draw_chair(SeededRandom& random) {
  Thing chair;
  const double side = random.uniform(0.4, 0.5), seat = random.uniform(0.42, 0.5);
  const Material wood = draw_object(random);
  chair.solids.push_back(box({0, 0, seat}, {side, side, 0.06}, draw_object(random)));
  chair.solids.push_back(box({0, 0.46 * side, seat + 0.3}, {side, 0.05, 0.5}, wood));
  for (double x : {-0.44, 0.44}) {
    for (double y : {-0.44, 0.44}) {
      chair.solids.push_back(box({x * side, y * side, 0.5 * seat}, {0.05, 0.05, seat}, wood));
    }
  }
  chair.radius = 0.72 * side;
  return chair;
}

Thing draw_sofa(SeededRandom& random) {
  Thing sofa;
  const double width = random.uniform(1.1, 1.7), depth = random.uniform(0.7, 0.85);
  const Material cloth = draw_object(random);
  sofa.solids.push_back(box({0, 0, 0.2}, {width, depth, 0.4}, cloth));
  sofa.solids.push_back(box({0, 0.42 * depth, 0.55}, {width, 0.16 * depth, 0.4}, cloth));
  for (double x : {-0.47, 0.47}) {
    sofa.solids.push_back(box({x * width, 0, 0.5}, {0.08 * width, depth, 0.22}, cloth));
  }
  const Material cushion = draw_object(random);
  sofa.solids.push_back(
      box({random.uniform(-0.25, 0.25) * width, 0.2 * depth, 0.55}, {0.35, 0.12, 0.3}, cushion));
  sofa.radius = 0.5 * std::hypot(width, depth);
  return sofa;
}

Thing draw_shelf(SeededRandom& random) {
  Thing shelf;
  const double width = random.uniform(0.7, 1.1), height = random.uniform(1.2, 1.9);
  constexpr double kDepth = 0.3;
  const Material wood = draw_object(random);
  for (double x : {-0.5, 0.5}) {
    shelf.solids.push_back(box({x * width, 0, 0.5 * height}, {0.04, kDepth, height}, wood));
  }
  const int64_t boards = random.integer(3, 4);
  for (int64_t i = 0; i < boards; ++i) {
    const double z = height * (static_cast<double>(i) + 0.5) / static_cast<double>(boards);
    shelf.solids.push_back(box({0, 0, z}, {width, kDepth, 0.04}, wood));
    const double tall = random.uniform(0.12, 0.28), wide = random.uniform(0.15, 0.6);
    const Vector3d size(wide * width, 0.2, tall);
    const Material material = draw_object(random);
    shelf.solids.push_back(
        box({random.uniform(-0.15, 0.15) * width, 0, z + 0.02 + 0.5 * size.z()}, size, material));
  }
  shelf.radius = 0.5 * std::hypot(width, kDepth);
  return shelf;
}

// Draws a floor lamp (not lit) or a plant in a pot.
Thing draw_tall(SeededRandom& random) {
  Thing thing;
  thing.radius = random.uniform(0.2, 0.3);
  if (random.chance(0.5)) {
    const double height = random.uniform(1.1, 1.6);
    const Material metal = draw_object(random);
    thing.solids.push_back(cylinder({0, 0, 0}, 0.7 * thing.radius, 0.05, metal));
    thing.solids.push_back(cylinder({0, 0, 0.05}, 0.03, height, metal));
    thing.solids.push_back(cylinder({0, 0, height}, thing.radius, 0.3, draw_object(random)));
    return thing;
  }
  const double pot = random.uniform(0.3, 0.5);
  thing.solids.push_back(cylinder({0, 0, 0}, 0.7 * thing.radius, pot, draw_object(random)));
  Material leaves;
  leaves.seed = random.bits();
  leaves.pattern = Pattern::kMarble;
  const double value = random.uniform(0.45, 0.7);
  leaves.first = colour_from_hsv(random.uniform(0.25, 0.4), 0.6, value);
  leaves.second = 0.5 * leaves.first;
  leaves.period = 0.12;
  for (int64_t i = 0; i < 4; ++i) {
    const double radius = random.uniform(0.4, 0.6) * thing.radius;
    thing.solids.push_back(sphere({random.uniform(-0.4, 0.4) * thing.radius,
                                   random.uniform(-0.4, 0.4) * thing.radius, pot + random.uniform(0.1, 0.5)},
                                  radius, leaves));
  }
  return thing;
}

// Slow sines with random phases, in [-1, 1] about: how a hand drifts.
class Sway {
 public:
  explicit Sway(SeededRandom& random) {
    for (Wave& wave : waves_) wave = {random.uniform(1.5, 6.0), random.uniform(0, 2 * kPi)};
  }
  double at(double progress) const {
    double sum = 0;
    for (const Wave& wave : waves_) sum += std::sin(2 * kPi * wave.frequency * progress + wave.phase);
    return sum / static_cast<double>(waves_.size());
  }

 private:
  struct Wave {
    double frequency = 0;  // over the whole path
    double phase = 0;
  };
  std::array<Wave, 3> waves_;
};

struct PathPoint {
  Vector3d eye;
  Vector3d target;
};

// A path as a function of progress in [0, 1].
class Path {
 public:
  Path(SeededRandom& random, const Room& room) : kind_(random.integer(0, 2)), room_(room) {
    from_angle_ = random.uniform(0, 2 * kPi);
    const double span = random.uniform(0.6, 1.7);
    to_angle_ = from_angle_ + (random.chance(0.5) ? span : -span);
    from_radius_ = random.uniform(0.65, 0.88);
    to_radius_ = kind_ == 1 ? random.uniform(0.35, 0.55) : random.uniform(0.65, 0.88);
    if (kind_ == 1) to_angle_ = from_angle_ + 0.35 * (to_angle_ - from_angle_);
    from_height_ = random.uniform(1.0, std::min(1.9, room.height - 0.5));
    to_height_ = random.uniform(1.0, std::min(1.9, room.height - 0.5));
    for (Vector3d* target : {&from_target_, &to_target_}) {
      *target = {random.uniform(-0.25, 0.25) * room.half_x, random.uniform(-0.25, 0.25) * room.half_y,
                 random.uniform(0.5, 1.1)};
    }
  }
  PathPoint at(double progress) const {
    const double t = 0.5 * (progress + smooth(progress));  // gentle at both ends, never standing still
    const double radius = from_radius_ + t * (to_radius_ - from_radius_);
    const double height = from_height_ + t * (to_height_ - from_height_);
    PathPoint point;
    if (kind_ == 2) {  // straight from one end of the arc to the other
      const Vector2d from = radius * Vector2d(std::cos(from_angle_), std::sin(from_angle_));
      const Vector2d to = radius * Vector2d(std::cos(to_angle_), std::sin(to_angle_));
      const Vector2d eye = from + t * (to - from);
      point.eye = {eye.x() * room_.half_x, eye.y() * room_.half_y, height};
    } else {
      const double angle = from_angle_ + t * (to_angle_ - from_angle_);
      point.eye = {radius * std::cos(angle) * room_.half_x, radius * std::sin(angle) * room_.half_y, height};
    }
    point.target = from_target_ + t * (to_target_ - from_target_);
    return point;
  }

 private:
  int64_t kind_;
  Room room_;
  double from_angle_ = 0, to_angle_ = 0;
  double from_radius_ = 0, to_radius_ = 0;
  double from_height_ = 0, to_height_ = 0;
  Vector3d from_target_, to_target_;
};

double least_clearance(const SyntheticWorld& world, const Path& path) {
  double least = 1e9;
  for (int i = 0; i <= 32; ++i) {
    const PathPoint point = path.at(i / 32.0);
    const double gap = (point.target - point.eye).norm() > 0.8 ? clearance(world, point.eye) : -1;
    least = std::min(least, gap);
  }
  return least;
}

Path draw_free_path(SeededRandom& random, const SyntheticWorld& world) {
  Path best(random, world.room);
  double best_clearance = least_clearance(world, best);
  for (int attempt = 0; attempt < 200 && best_clearance < kLowestClearance; ++attempt) {
    const Path path(random, world.room);
    const double gap = least_clearance(world, path);
    if (gap > best_clearance) {
      best = path;
      best_clearance = gap;
    }
  }
  return best;
}

}  // namespace

SyntheticWorld draw_world(SeededRandom& random, const ObjectCount& objects) {
  SyntheticWorld world;
  Room& room = world.room;
  room.half_x = random.uniform(2.2, 3.5);
  room.half_y = random.uniform(2.2, 3.5);
  room.height = random.uniform(2.5, 3.2);
  const double hue = random.uniform();
  for (int face = 0; face < 4; ++face) room.faces[face] = draw_wall(random, hue + (face == 0 ? 0.45 : 0.0));
  room.faces[4] = draw_floor(random);
  room.faces[5].first = colour_from_hsv(hue, 0.04, 0.95);
  furnish(random, objects, world);
  hang_pictures(random, world);
  light_up(random, world);
  return world;
}

void vary_world(SeededRandom& random, SyntheticWorld& world) {
  const int64_t wanted = random.integer(1, 4);
  int64_t placed = 0;
  for (int64_t attempt = 0; attempt < 30 * wanted && placed < wanted; ++attempt) {
    const double kind = random.uniform();
    Thing thing = kind < 0.3   ? draw_chair(random)
                  : kind < 0.5 ? draw_sofa(random)
                  : kind < 0.7 ? draw_shelf(random)
                               : draw_tall(random);
    const double reach_x = world.room.half_x - thing.radius - 0.05;
    const double reach_y = world.room.half_y - thing.radius - 0.05;
    const Vector2d centre = draw_position(random, {reach_x, reach_y});
    const double turn = random.uniform(0, 2 * kPi);
    const bool free = std::none_of(world.solids.begin(), world.solids.end(), [&](const Solid& other) {
      return (other.centre.head<2>() - centre).norm() < other.bounding_radius() + thing.radius;
    });
    if (!free) continue;
    place(thing, centre, turn);
    world.solids.insert(world.solids.end(), thing.solids.begin(), thing.solids.end());
    ++placed;
  }
  const auto finish = [&](Material& material, double glossy, double dark) {
    if (random.chance(glossy)) material.gloss = random.uniform(0.2, 0.8);
    if (random.chance(dark)) {
      const double share = random.uniform(0.08, 0.3);
      material.first *= share;
      material.second *= share;
    }
  };
  for (Solid& solid : world.solids) finish(solid.material, 0.3, 0.12);
  for (int face = 0; face < 4; ++face) finish(world.room.faces[face], 0.05, 0.05);
  finish(world.room.faces[4], 0.3, 0.1);
}

Eigen::Isometry3d look_at(const Vector3d& eye, const Vector3d& target) {
  const Vector3d forward = (target - eye).normalized();
  const Vector3d right = forward.cross(Vector3d::UnitZ()).normalized();
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear().col(0) = right;
  pose.linear().col(1) = forward.cross(right);
  pose.linear().col(2) = forward;
  pose.translation() = eye;
  return pose;
}

std::vector<Camera> draw_camera_path(SeededRandom& random, const SyntheticWorld& world,
                                     const PathDraw& draw) {
  const double field = random.uniform(draw.field_of_view_low, draw.field_of_view_high) * kPi / 180;
  const double focal = 0.5 * static_cast<double>(std::max(draw.width, draw.height)) / std::tan(0.5 * field);
  const Path path = draw_free_path(random, world);
  // Drawn last, so that the steady path is the same with a hand and without.
  const std::array<Sway, 3> eye_sways = {Sway(random), Sway(random), Sway(random)};
  const std::array<Sway, 3> turn_sways = {Sway(random), Sway(random), Sway(random)};
  std::vector<Camera> cameras;
  for (int64_t i = 0; i < draw.frames; ++i) {
    const double progress =
        draw.frames == 1 ? 0.5 : static_cast<double>(i) / static_cast<double>(draw.frames - 1);
    const PathPoint point = path.at(progress);
    Camera camera;
    camera.width = draw.width;
    camera.height = draw.height;
    camera.intrinsics = intrinsic_matrix(focal, focal, 0.5 * static_cast<double>(draw.width),
                                         0.5 * static_cast<double>(draw.height));
    Vector3d eye = point.eye;
    for (int axis = 0; axis < 3; ++axis)
      eye[axis] += draw.hand.sway * eye_sways[static_cast<size_t>(axis)].at(progress);
    camera.world_from_camera = look_at(eye, point.target);
    const Vector3d largest(draw.hand.aim, draw.hand.aim, draw.hand.roll);  // about x, y, z of the camera
    if (!largest.isZero()) {
      for (int axis = 0; axis < 3; ++axis) {
        const double angle = largest[axis] * kPi / 180 * turn_sways[static_cast<size_t>(axis)].at(progress);
        camera.world_from_camera.rotate(Eigen::AngleAxisd(angle, Vector3d::Unit(axis)));
      }
    }
    cameras.push_back(camera);
  }
  return cameras;
}

}  // namespace gld
