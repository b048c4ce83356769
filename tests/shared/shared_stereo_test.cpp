// Depth that the photographs of whole real scenes agree on, beside COLMAP's points and measured depth.
#include "datasets/formats/scene_reader.h"
#include "datasets/scenes/resize_crop.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"
#include "tests/support/data_folders.h"
#include "tests/support/stereo_scenes.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <vector>

#include <gtest/gtest.h>

namespace gld::test {
namespace {

// Points are of the whole model, so that some lie behind what a view shows: those are left out that lie more than this
// share behind the nearest point that falls within a few pixels.
constexpr double kBehind = 1.05;

struct LundDoor {
  std::vector<PicturedView> views;
  std::vector<Eigen::Vector3d> points;

  explicit LundDoor(const std::vector<size_t>& frames) {
    const Scene scene = open_scene(shared_data() / "scenes" / "colmap_lund_door");
    for (const size_t frame : frames) views.push_back(pictured(scene.frames[frame], 448, FrameParts::kImage));
    points = scene.points_in_world;
  }
};

// |depth - z| / z of the points that a view sees, where it is confident.
StereoFigures beside_points(const StereoScene& scene, const LundDoor& door) {
  StereoFigures figures;
  for (size_t i = 0; i < door.views.size(); ++i) {
    const Camera& camera = door.views[i].camera;
    const StereoDepth& found = scene.views[i];
    const Eigen::Isometry3d camera_from_world = camera.camera_from_world();
    struct Seen {
      int64_t x, y;
      double z;
    };
    std::vector<Seen> seen;
    const double columns = static_cast<double>(found.depth.width) / static_cast<double>(camera.width);
    const double rows = static_cast<double>(found.depth.height) / static_cast<double>(camera.height);
    for (const Eigen::Vector3d& point : door.points) {
      const Eigen::Vector3d in_camera = camera_from_world * point;
      if (!(in_camera.z() > 0)) continue;
      const Eigen::Vector3d pixel = camera.intrinsics * in_camera;
      const auto x = static_cast<int64_t>(std::floor(pixel.x() / pixel.z() * columns));
      const auto y = static_cast<int64_t>(std::floor(pixel.y() / pixel.z() * rows));
      if (x < 0 || y < 0 || x >= found.depth.width || y >= found.depth.height) continue;
      seen.push_back({x, y, in_camera.z()});
    }
    for (const Seen& point : seen) {
      const bool hidden = std::any_of(seen.begin(), seen.end(), [&](const Seen& other) {
        return std::abs(other.x - point.x) <= 4 && std::abs(other.y - point.y) <= 4 &&
               other.z * kBehind < point.z;
      });
      if (!hidden) figures.add(found, static_cast<size_t>(point.y * found.depth.width + point.x), point.z);
    }
    figures.count_confident(found);
  }
  return figures;
}

TEST(SharedStereo, LundDoorAgreesWithColmapsPoints) {
  for (const auto& frames : {std::vector<size_t>{3, 6}, std::vector<size_t>{2, 4, 6, 8}}) {
    for (const bool with_points : {true, false}) {
      const LundDoor door(frames);
      KernelSettings settings;
      settings.threads = 2;
      const CpuSeconds seconds;
      const StereoScene scene =
          stereo_depth(door.views, with_points ? door.points : std::vector<Eigen::Vector3d>(), {}, settings);
      const double taken = seconds();
      const StereoFigures figures = beside_points(scene, door);
      std::cout << "Lund door, " << frames.size() << " views, " << (with_points ? "with" : "without")
                << " points: " << figures.text() << ", " << taken << " CPU s\n";
      // Issue M's figure; a numpy prototype reached .006 to .009 at 112x112.
      EXPECT_LT(figures.mean(), 0.03);
      EXPECT_GT(figures.confident_share(), 0.5);
    }
  }
}

TEST(SharedStereo, TartanAirAgreesWithItsDepth) {
  const Scene scene = open_scene(shared_data() / "scenes" / "tartanair_hospital");
  for (const auto& frames : {std::vector<size_t>{0, 3}, std::vector<size_t>{0, 2, 4, 6}}) {
    std::vector<PicturedView> views;
    views.reserve(frames.size());
    for (const size_t frame : frames)
      views.push_back(pictured(scene.frames[frame], 448, FrameParts::kImageAndDepth));
    KernelSettings settings;
    settings.threads = 2;
    // Issue M asks for .02, which photographs of their own size have; the default, half of it, carries pictures
    // best, and its planes lie twice as far apart.
    struct Expected {
      int64_t largest_side;
      double error;
    };
    for (const Expected& expected : {Expected{448, 0.02}, Expected{StereoOptions().largest_side, 0.03}}) {
      StereoOptions options;
      options.largest_side = expected.largest_side;
      const CpuSeconds seconds;
      const StereoScene found = stereo_depth(without_prior(views), {}, options, settings);
      const double taken = seconds();
      const StereoFigures figures = beside_depth(found, views);
      std::cout << "TartanAir, " << frames.size() << " views at " << expected.largest_side
                << " pixels: " << figures.text() << ", " << taken << " CPU s\n";
      EXPECT_LT(figures.mean(), expected.error);
      // Walls without texture, and 0 and 3 overlap by half.
      EXPECT_GT(figures.confident_share(), 0.15);
    }
  }
}

}  // namespace
}  // namespace gld::test
