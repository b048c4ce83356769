#include "datasets/synthetic/synthetic_scene.h"

#include "datasets/check/depth_warp.h"
#include "datasets/scenes/frame_checks.h"
#include "datasets/synthetic/photographic_look.h"
#include "datasets/synthetic/photographic_world.h"
#include "datasets/synthetic/synthetic_layout.h"
#include "datasets/synthetic/synthetic_renderer.h"
#include "gld/base/configuration.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <thread>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;

SyntheticOptions small_options() {
  SyntheticOptions options;
  options.width = 64;
  options.height = 48;
  options.frames = 6;
  options.seed = 11;
  return options;
}

// An empty room with plain walls and one lamp.
SyntheticWorld bare_room() {
  SyntheticWorld world;
  world.lamps.push_back({{0, 0, 2.5}, 0.2, Vector3d::Constant(1)});
  return world;
}

Camera camera_at(const Vector3d& eye, const Vector3d& target) {
  Camera camera;
  camera.width = 64;
  camera.height = 48;
  camera.intrinsics = intrinsic_matrix(50, 50, 32, 24);
  camera.world_from_camera = look_at(eye, target);
  return camera;
}

TEST(SyntheticScene, TheSameSeedGivesTheSameBytes) {
  const Scene first = make_synthetic_scene(small_options(), 3);
  const Scene second = make_synthetic_scene(small_options(), 3);
  ASSERT_EQ(first.frames.size(), 6U);
  EXPECT_EQ(first.frames[2].image().rgb, second.frames[2].image().rgb);
  EXPECT_EQ(first.frames[2].depth().metres, second.frames[2].depth().metres);
  SyntheticOptions shifted = small_options();
  shifted.first_scene = 3;
  EXPECT_EQ(make_synthetic_scene(shifted, 0).frames[2].image().rgb, first.frames[2].image().rgb);
  SyntheticOptions other = small_options();
  other.seed = 12;
  EXPECT_NE(make_synthetic_scene(other, 3).frames[2].image().rgb, first.frames[2].image().rgb);
}

TEST(SyntheticScene, FramesMayBeDrawnFromSeveralThreads) {
  const Scene scene = make_synthetic_scene(small_options(), 0);
  const Image expected = scene.frames[0].image();
  std::vector<Image> drawn(4);
  std::vector<std::thread> threads;
  threads.reserve(drawn.size());
  for (Image& image : drawn) threads.emplace_back([&] { image = scene.frames[0].image(); });
  for (std::thread& thread : threads) thread.join();
  for (const Image& image : drawn) EXPECT_EQ(image.rgb, expected.rgb);
}

TEST(SyntheticScene, DepthOfAWallIsPlanar) {
  const SyntheticWorld world = bare_room();
  // Looking along x from the middle, the wall x = 2 is 2 metres away in every pixel that sees it.
  const DepthMap depth = render_depth(world, camera_at({0, 0, 1.35}, {2, 0, 1.35}));
  EXPECT_NEAR(depth.at(32, 24), 2, 1e-6);
  EXPECT_NEAR(depth.at(5, 24), 2, 1e-6);
  EXPECT_NEAR(depth.at(60, 20), 2, 1e-6);
}

TEST(SyntheticScene, DepthOfASphereIsExact) {
  SyntheticWorld world = bare_room();
  Solid ball;
  ball.shape = Shape::kSphere;
  ball.centre = {1, 0.2, 1.3};
  ball.half_size = Vector3d::Constant(0.5);
  world.solids.push_back(ball);
  const Camera camera = camera_at({-1, 0, 1.35}, {1, 0.1, 1.3});
  const DepthMap depth = render_depth(world, camera);
  int64_t on_ball = 0;
  for (int64_t y = 0; y < depth.height; ++y) {
    for (int64_t x = 0; x < depth.width; ++x) {
      const Vector3d in_camera((static_cast<double>(x) + 0.5 - 32) / 50,
                               (static_cast<double>(y) + 0.5 - 24) / 50, 1);
      const Vector3d point = camera.world_from_camera * (in_camera * depth.at(x, y));
      const double off_ball = std::abs((point - ball.centre).norm() - 0.5);
      if (off_ball < 0.01) {
        ++on_ball;
        EXPECT_LT(off_ball, 1e-6);
      } else {
        const double off_room = std::min(
            {2 - std::abs(point.x()), 2 - std::abs(point.y()), point.z(), world.room.height - point.z()});
        EXPECT_LT(std::abs(off_room), 1e-6);
      }
    }
  }
  EXPECT_GT(on_ball, 300);
}

TEST(SyntheticScene, ShadowsAreSoftAndBelowTheirObject) {
  SyntheticWorld world = bare_room();
  Solid ball;
  ball.shape = Shape::kSphere;
  ball.centre = {0, 0, 1};
  ball.half_size = Vector3d::Constant(0.4);
  world.solids.push_back(ball);
  // It looks down on the floor from beside the ball.
  Camera camera = camera_at({1.6, 0, 0.6}, {0, 0, 0});
  const Image image = render_image(world, camera);
  const DepthMap depth = render_depth(world, camera);
  std::vector<int> shadow;
  std::vector<int> lit;
  std::vector<int> between;
  for (int64_t y = 0; y < 48; ++y) {
    for (int64_t x = 0; x < 64; ++x) {
      const Vector3d in_camera((static_cast<double>(x) + 0.5 - 32) / 50,
                               (static_cast<double>(y) + 0.5 - 24) / 50, 1);
      const Vector3d point = camera.world_from_camera * (in_camera * depth.at(x, y));
      if (point.z() > 1e-6) continue;
      const double radius = std::hypot(point.x(), point.y());
      // The lamp is at 2.5 m and the ball of 0.4 m at 1 m: the umbra on the floor ends near 0.52 m, the penumbra near
      // 0.82 m.
      if (radius < 0.4) shadow.push_back(image.pixel(x, y)[0]);
      if (radius > 0.62 && radius < 0.68) between.push_back(image.pixel(x, y)[0]);
      if (radius > 0.95 && radius < 1.1) lit.push_back(image.pixel(x, y)[0]);
    }
  }
  ASSERT_FALSE(shadow.empty() || lit.empty() || between.empty());
  const auto mean = [](const std::vector<int>& values) {
    return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
  };
  EXPECT_LT(mean(shadow) + 25, mean(between));
  EXPECT_LT(mean(between) + 15, mean(lit));
}

TEST(SyntheticScene, ViewsAgreeAndOverlap) {
  for (int64_t index = 0; index < 6; ++index) {
    SyntheticOptions options = small_options();
    options.frames = 24;
    const Scene scene = make_synthetic_scene(options, index);
    const Frame& a = scene.frames[8];
    const Frame& b = scene.frames[12];
    const WarpResult warp = warp_depth({a.camera, a.depth()}, {b.camera, b.depth()}, 0.01);
    EXPECT_GT(warp.share_in_view, 0.5) << index;
    EXPECT_GT(warp.share_agreeing, 0.75) << index;
    EXPECT_LT(warp.median_error, 2e-3) << index;
  }
}

TEST(SyntheticScene, CamerasKeepClearOfEverything) {
  for (uint64_t seed = 0; seed < 40; ++seed) {
    SeededRandom world_random({seed, 1});
    SeededRandom path_random({seed, 2});
    const SyntheticWorld world = draw_world(world_random, {3, 8});
    double least = 1e9;
    for (const Camera& camera : draw_camera_path(path_random, world, {})) {
      least = std::min(least, clearance(world, camera.world_from_camera.translation()));
    }
    EXPECT_GT(least, 0.25) << seed;
  }
}

TEST(SyntheticScene, ThingsStandOnTheFloorInsideTheRoom) {
  for (uint64_t seed = 0; seed < 40; ++seed) {
    SeededRandom random({seed, 1});
    const SyntheticWorld world = draw_world(random, {3, 8});
    EXPECT_GE(world.solids.size(), 3U);
    for (const Solid& solid : world.solids) {
      EXPECT_GE(solid.centre.z() - solid.half_size.z(), -1e-9);
      EXPECT_LT(std::abs(solid.centre.x()), world.room.half_x);
      EXPECT_LT(std::abs(solid.centre.y()), world.room.half_y);
      EXPECT_LT(solid.centre.z(), world.room.height);
    }
  }
}

TEST(SyntheticScene, VariedRoomsKeepHalfAsTheyWereAndClutterTheRest) {
  SyntheticOptions first = small_options(), varied = small_options();
  varied.rooms = SyntheticRooms::kVaried;
  int same = 0, rolled = 0;
  for (int64_t index = 0; index < 60; ++index) {
    const Scene a = make_synthetic_scene(first, index), b = make_synthetic_scene(varied, index);
    const Eigen::Matrix3d turn = b.frames[2].camera.world_from_camera.linear();
    if (a.frames[2].camera.world_from_camera.matrix() == b.frames[2].camera.world_from_camera.matrix()) {
      ++same;
    } else if (std::abs(turn(2, 0)) > 0.01) {
      ++rolled;  // the image's horizontal is not the room's
    }
  }
  EXPECT_NEAR(same, 30, 9);
  EXPECT_GT(rolled, 8);
}

// Things must be on the floor or above it, below the ceiling, and between the walls.
void expect_inside(const SyntheticWorld& world) {
  for (const Solid& solid : world.solids) {
    EXPECT_GE(solid.centre.z() - solid.half_size.z(), -1e-9);
    EXPECT_LT(std::abs(solid.centre.x()), world.room.half_x);
    EXPECT_LT(std::abs(solid.centre.y()), world.room.half_y);
    EXPECT_LT(solid.centre.z() + solid.half_size.z(), world.room.height);
  }
}

TEST(SyntheticScene, VariedRoomsAreExactToo) {
  SyntheticOptions options = small_options();
  options.rooms = SyntheticRooms::kVaried;
  options.frames = 24;
  for (int64_t index = 0; index < 6; ++index) {
    const Scene scene = make_synthetic_scene(options, index);
    const Frame& a = scene.frames[8];
    const Frame& b = scene.frames[11];
    const WarpResult warp = warp_depth({a.camera, a.depth()}, {b.camera, b.depth()}, 0.01);
    EXPECT_GT(warp.share_agreeing, 0.7) << index;
    EXPECT_LT(warp.median_error, 2e-3) << index;
    EXPECT_EQ(make_synthetic_scene(options, index).frames[8].image().rgb, a.image().rgb);
  }
  for (uint64_t seed = 0; seed < 40; ++seed) {
    SeededRandom world_random({seed, 1}), variety({seed, 3}), path_random({seed, 2});
    SyntheticWorld world = draw_world(world_random, {3, 8});
    const size_t before = world.solids.size();
    vary_world(variety, world);
    EXPECT_GT(world.solids.size(), before) << seed;
    PathDraw draw;
    draw.hand = {0.08, 4, 8};
    expect_inside(world);
    for (const Camera& camera : draw_camera_path(path_random, world, draw)) {
      EXPECT_GT(clearance(world, camera.world_from_camera.translation()), 0.0) << seed;
      EXPECT_LT((camera.world_from_camera.linear().transpose() * camera.world_from_camera.linear() -
                 Eigen::Matrix3d::Identity())
                    .norm(),
                1e-12);
    }
  }
}

TEST(SyntheticScene, GlossShowsTheLampWhereItIsMirrored) {
  SyntheticWorld world = bare_room();
  world.room.faces[4].first = Vector3d::Constant(0.2);
  const Camera camera = camera_at({-1, 0, 1.4}, {-0.3, 0, 0});
  const Image matte = render_image(world, camera);
  world.room.faces[4].gloss = 0.8;
  const Image glossy = render_image(world, camera);
  // The lamp at (0, 0, 2.5) seen from (-1, 0, 1.4) is mirrored by the floor at x = -1 + 1.4 / 3.9.
  const Vector3d mirrored(-1 + 1.4 / 3.9, 0, 0);
  const Vector3d pixel = camera.intrinsics * (camera.camera_from_world() * mirrored);
  const auto x = static_cast<int64_t>(pixel.x() / pixel.z()), y = static_cast<int64_t>(pixel.y() / pixel.z());
  ASSERT_TRUE(x >= 0 && x < 64 && y >= 0 && y < 48);
  EXPECT_GT(glossy.pixel(x, y)[0], matte.pixel(x, y)[0] + 30);
  EXPECT_LT(glossy.pixel(0, 0)[0], matte.pixel(0, 0)[0] + 8);  // far from it
}

TEST(SyntheticScene, ImagesUseTheWholeRange) {
  for (int64_t index = 0; index < 8; ++index) {
    const Image image = make_synthetic_scene(small_options(), index).frames[0].image();
    std::vector<uint8_t> sorted = image.rgb;
    std::sort(sorted.begin(), sorted.end());
    EXPECT_LT(sorted[sorted.size() / 20], 140) << index;
    EXPECT_GT(sorted[sorted.size() * 19 / 20], 130) << index;
    EXPECT_GT(sorted[sorted.size() * 19 / 20] - sorted[sorted.size() / 20], 60) << index;
  }
}

TEST(SyntheticScene, OptionsThatContradictAreRefused) {
  SyntheticOptions options;
  options.most_objects = 2;
  EXPECT_EQ(test::error_of([&] { SyntheticDataset dataset(options); }),
            "most_objects: expected at least fewest_objects (3), found 2; raise it.");
  SyntheticOptions narrow;
  EXPECT_EQ(test::error_of([&] { apply_setting(narrow, "width=4"); }).substr(0, 5), "--set");
}

// Returns what differs from room to room, as one number: where things stand and what colours they have.
double content_of(const SyntheticWorld& world) {
  double sum = 0, weight = 1;
  const auto add = [&](double value) {
    sum += weight * value;
    weight = weight < 7 ? weight + 0.37 : 1;  // numbers that change places do not go unseen
  };
  const auto add_material = [&](const Material& material) {
    for (const Vector3d& colour : {material.first, material.second}) {
      for (int channel = 0; channel < 3; ++channel) add(colour[channel]);
    }
    add(material.period);
    add(material.angle);
    add(static_cast<double>(material.pattern));
    add(material.stains);
  };
  for (const Material& face : world.room.faces) add_material(face);
  for (const Solid& solid : world.solids) {
    for (int axis = 0; axis < 3; ++axis) add(solid.centre[axis] + 2 * solid.half_size[axis]);
    add(solid.turn);
    add_material(solid.material);
  }
  for (const Decal& decal : world.decals) {
    add(decal.low.x() + 2 * decal.low.y() + 3 * decal.high.x() + 4 * decal.high.y());
    add_material(decal.material);
  }
  for (const Lamp& lamp : world.lamps) add(lamp.centre.sum() + 2 * lamp.radius + 3 * lamp.power.sum());
  add(world.ambient.x() + 2 * world.ambient.y() + 3 * world.ambient.z());
  return sum;
}

// g++ and clang evaluate a call's arguments in other orders: never are two numbers drawn there.
TEST(SyntheticScene, EveryCompilerDrawsTheSameRooms) {
  double first = 0, varied = 0, photographic = 0, paths = 0, looks = 0;
  for (uint64_t number = 0; number < 20; ++number) {
    SeededRandom random({5, number, 1}), variety({5, number, 3}), photographs({5, number, 4});
    SyntheticWorld world = draw_world(random, {3, 8});
    first += content_of(world);
    vary_world(variety, world);
    varied += content_of(world);
    make_photographic(photographs, world);
    photographic += content_of(world);
    for (const Camera& camera : draw_camera_path(random, world, {}))
      paths += camera.world_from_camera.matrix().sum() + camera.intrinsics(0, 0);
    const PhotographicLook look = draw_photographic_look(photographs);
    looks += look.contrast + 2 * look.balance.sum() + look.vignetting + look.blur + look.exposure_spread +
             look.noise;
  }
  EXPECT_NEAR(first, 20675.110067041, 1e-6);
  EXPECT_NEAR(varied, 32602.519570763, 1e-6);
  EXPECT_NEAR(photographic, 54219.449625583, 1e-6);
  EXPECT_NEAR(paths, 45271.962827368, 1e-6);
  EXPECT_NEAR(looks, 141.078750347, 1e-6);
}

// Returns the share of neighbouring pixels that have the same colour to one step of 255.
double share_of_flat_pixels(const Image& image) {
  int64_t flat = 0;
  for (int64_t y = 0; y < image.height; ++y) {
    for (int64_t x = 1; x < image.width; ++x) {
      int largest = 0;
      for (int channel = 0; channel < 3; ++channel)
        largest = std::max(largest, std::abs(image.pixel(x, y)[channel] - image.pixel(x - 1, y)[channel]));
      flat += largest <= 1 ? 1 : 0;
    }
  }
  return static_cast<double>(flat) / static_cast<double>(image.height * (image.width - 1));
}

TEST(SyntheticScene, PhotographicRoomsKeepHalfAsTheyWereAndRoughenTheRest) {
  SyntheticOptions varied = small_options(), photographic = small_options();
  varied.rooms = SyntheticRooms::kVaried;
  photographic.rooms = SyntheticRooms::kPhotographic;
  int same = 0;
  double flat_before = 0, flat = 0;
  for (int64_t index = 0; index < 40; ++index) {
    const Image a = make_synthetic_scene(varied, index).frames[2].image();
    const Image b = make_synthetic_scene(photographic, index).frames[2].image();
    if (a.rgb == b.rgb) {
      ++same;
    } else {
      flat_before += share_of_flat_pixels(a);
      flat += share_of_flat_pixels(b);
    }
  }
  EXPECT_NEAR(same, 20, 8);
  EXPECT_LT(flat, 0.5 * flat_before);
}

TEST(SyntheticScene, PhotographicRoomsAreExactToo) {
  SyntheticOptions options = small_options();
  options.rooms = SyntheticRooms::kPhotographic;
  options.frames = 24;
  for (int64_t index = 0; index < 8; ++index) {
    const Scene scene = make_synthetic_scene(options, index);
    const Frame& a = scene.frames[8];
    const Frame& b = scene.frames[11];
    const WarpResult warp = warp_depth({a.camera, a.depth()}, {b.camera, b.depth()}, 0.01);
    EXPECT_GT(warp.share_agreeing, 0.6) << index;
    EXPECT_LT(warp.median_error, 2e-3) << index;
    EXPECT_EQ(make_synthetic_scene(options, index).frames[8].image().rgb, a.image().rgb);
  }
  for (uint64_t seed = 0; seed < 40; ++seed) {
    SeededRandom random({seed, 1}), variety({seed, 3}), photographs({seed, 4}), path_random({seed, 2});
    SyntheticWorld world = draw_world(random, {3, 8});
    PathDraw draw;
    if (seed % 2 == 1) {  // as half of the photographic rooms are
      vary_world(variety, world);
      draw.hand = {0.08, 4, 8};
    }
    make_photographic(photographs, world);
    expect_inside(world);
    for (const Decal& decal : world.decals)
      EXPECT_LT(decal.high.y(), std::max(world.room.height, world.room.half_y + 1e-9));
    for (const Camera& camera : draw_camera_path(path_random, world, draw))
      EXPECT_GT(clearance(world, camera.world_from_camera.translation()), 0.1) << seed;
  }
}

}  // namespace
}  // namespace gld
