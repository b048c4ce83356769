// Layouts of recorded trajectories: RealEstate10K, TartanAir.
#include "datasets/formats/depth_files.h"
#include "datasets/formats/scene_layouts.h"
#include "datasets/images/image_file.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <Eigen/Geometry>
#include <fmt/format.h>

namespace gld {
namespace {

// Returns the one camera of all frames.
const Camera& shared_camera(const Scene& scene) {
  const Camera& first = scene.frames.front().camera;
  for (const Frame& frame : scene.frames) {
    if (frame.camera.width != first.width || frame.camera.height != first.height ||
        (frame.camera.intrinsics - first.intrinsics).cwiseAbs().maxCoeff() > 1e-9) {
      fail({"tartanair layout", "one size and lens for all frames", "another one in " + frame.name,
            "choose another layout"});
    }
  }
  return first;
}

void check_tartanair_camera(const Camera& camera) {
  const double width = static_cast<double>(camera.width);
  const double height = static_cast<double>(camera.height);
  Eigen::Matrix3d expected = Eigen::Matrix3d::Identity();
  expected(0, 0) = expected(1, 1) = expected(0, 2) = 0.5 * width;
  expected(1, 2) = 0.5 * height;
  if (3 * camera.width == 4 * camera.height &&
      (camera.intrinsics - expected).cwiseAbs().maxCoeff() < 1e-6 * width) {
    return;
  }
  fail({"tartanair layout", "images of 4:3 with a field of view of 90 degrees",
        fmt::format("{}x{} with fx {:.6g}", camera.width, camera.height, camera.intrinsics(0, 0)),
        "set width, height, field_of_view_low and field_of_view_high so, or choose another layout"});
}

}  // namespace

void write_re10k_layout(const Scene& scene, const std::filesystem::path& folder) {
  const auto images = folder / scene.name;
  std::filesystem::create_directories(images);
  std::string text = "https://example.org/" + scene.name + "\n";
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const Frame& frame = scene.frames[i];
    const Camera& camera = frame.camera;
    const auto width = static_cast<double>(camera.width);
    const auto height = static_cast<double>(camera.height);
    const int64_t time = 1'000'000 + 33'333 * static_cast<int64_t>(i);
    write_png(images / (std::to_string(time) + ".png"), frame.image());
    text += fmt::format("{} {} {} {} {} 0 0", time, camera.intrinsics(0, 0) / width,
                        camera.intrinsics(1, 1) / height, camera.intrinsics(0, 2) / width,
                        camera.intrinsics(1, 2) / height);
    const Eigen::Matrix4d pose = camera.camera_from_world().matrix();
    for (int k = 0; k < 12; ++k) text += fmt::format(" {}", pose(k / 4, k % 4));
    text += "\n";
  }
  write_file_atomically(folder / (scene.name + ".txt"), text);
}

void write_tartanair_layout(const Scene& scene, const std::filesystem::path& folder) {
  check_tartanair_camera(shared_camera(scene));
  std::filesystem::create_directories(folder / "image_left");
  std::filesystem::create_directories(folder / "depth_left");
  Eigen::Matrix3d opencv_from_ned;  // right is east, down is down, forward is north
  opencv_from_ned << 0, 1, 0, 0, 0, 1, 1, 0, 0;
  std::string text;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const Frame& frame = scene.frames[i];
    const std::string name = fmt::format("{:06}_left", i);
    write_png(folder / "image_left" / (name + ".png"), frame.image());
    if (frame.has_depth()) write_depth_npy(folder / "depth_left" / (name + "_depth.npy"), frame.depth());
    const Eigen::Matrix3d ned = frame.camera.world_from_camera.linear() * opencv_from_ned;
    const Eigen::Quaterniond q(ned);
    const Eigen::Vector3d t = frame.camera.world_from_camera.translation();
    text += fmt::format("{} {} {} {} {} {} {}\n", t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
  }
  write_file_atomically(folder / "pose_left.txt", text);
}

}  // namespace gld
