#include "datasets/synthetic/photographic_world.h"

#include "datasets/synthetic/photographic_material.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace gld {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kCeiling = 5;

// The ceiling gives way to the sky: higher walls, light from all of it.
void open_to_the_sky(SeededRandom& random, SyntheticWorld& world) {
  Room& room = world.room;
  const double before = room.height;
  room.height *= random.uniform(1.3, 2.2);
  world.decals.erase(std::remove_if(world.decals.begin(), world.decals.end(),
                                    [](const Decal& decal) { return decal.face == kCeiling; }),
                     world.decals.end());
  for (Lamp& lamp : world.lamps) {
    lamp.centre.z() = room.height - 0.05;
    lamp.power *= light_loss(room.height) / light_loss(before);
  }
  Decal sky;
  sky.face = kCeiling;
  sky.low = {-room.half_x, -room.half_y};
  sky.high = {room.half_x, room.half_y};
  sky.material.first = draw_colour(random, {0.52, 0.64}, {0, 0.5}, {0.8, 1});
  sky.glow = random.uniform(0.9, 1.4);
  world.decals.push_back(sky);
  world.ambient *= random.uniform(1.1, 1.6);
}

void put_up_posters(SeededRandom& random, SyntheticWorld& world) {
  const int64_t count = random.integer(0, 6);
  for (int64_t i = 0; i < count; ++i) {
    Decal poster;
    poster.face = static_cast<int>(random.integer(0, 3));
    const double half = poster.face < 2 ? world.room.half_y : world.room.half_x;
    const double width = random.uniform(0.3, 1.4), height = random.uniform(0.3, 1.2);
    const double along = random.uniform(-half, half - width);
    const double bottom = random.uniform(0.1, std::max(0.2, 0.9 * world.room.height - height));
    poster.low = {along, bottom};
    poster.high = {along + width, bottom + height};
    poster.material = draw_poster(random);
    world.decals.push_back(poster);
  }
}

// Piles up a bush or a heap: many small things about a place on the floor, some of them in the air as leaves are.
void pile_up(SeededRandom& random, SyntheticWorld& world) {
  const Room& room = world.room;
  const bool bush = random.chance(0.5);
  const double radius = random.uniform(0.25, 0.5), top = bush ? random.uniform(0.6, 1.4) : 0.5;
  const double reach_x = room.half_x - radius - 0.1, reach_y = room.half_y - radius - 0.1;
  const double x = random.uniform(-reach_x, reach_x), y = random.uniform(-reach_y, reach_y);
  const Vector2d middle(x, y);
  const bool free = std::none_of(world.solids.begin(), world.solids.end(), [&](const Solid& other) {
    return (other.centre.head<2>() - middle).norm() < other.bounding_radius() + radius;
  });
  if (!free) return;
  const Material leaves = draw_foliage(random);
  const int64_t count = random.integer(6, 12);
  for (int64_t i = 0; i < count; ++i) {
    Solid piece;
    const double size = bush ? random.uniform(0.06, 0.16) : random.uniform(0.05, 0.14);
    const double angle = random.uniform(0, 6.2831853),
                 from_middle = (radius - size) * std::sqrt(random.uniform());
    const double height = bush ? random.uniform(size, top) : size * random.uniform(0.8, 1.6);
    piece.shape = bush || random.chance(0.3) ? Shape::kSphere : Shape::kBox;
    piece.half_size = Vector3d::Constant(size);
    if (piece.shape == Shape::kBox) {
      piece.half_size.x() *= random.uniform(0.4, 1);
      piece.half_size.z() *= random.uniform(0.3, 1);
      piece.turn = random.uniform(0, 6.2831853);
    }
    piece.centre = {middle.x() + from_middle * std::cos(angle), middle.y() + from_middle * std::sin(angle),
                    std::max(height, piece.half_size.z())};
    piece.material = bush ? leaves : draw_weathered_object(random);
    world.solids.push_back(piece);
  }
}

}  // namespace

void make_photographic(SeededRandom& random, SyntheticWorld& world) {
  const bool yard = random.chance(0.35);
  if (yard) open_to_the_sky(random, world);
  for (int face = 0; face < 4; ++face) {
    Material& wall = world.room.faces[face];
    if (yard && random.chance(0.6)) {
      wall = draw_facade(random);
    } else if (random.chance(0.7)) {
      wall = draw_rough_wall(random);
    } else {
      wall.stains = random.uniform(0.1, 0.9);
    }
  }
  world.room.faces[4] = draw_ground(random);
  world.room.faces[kCeiling].stains = random.uniform(0, 0.3);
  for (Solid& solid : world.solids) {
    if (random.chance(0.6)) {
      solid.material = draw_weathered_object(random);
    } else {
      solid.material.stains = random.uniform(0, 0.8);
    }
  }
  put_up_posters(random, world);
  const int64_t piles = random.integer(0, 3);
  for (int64_t i = 0; i < piles; ++i) pile_up(random, world);
}

}  // namespace gld
