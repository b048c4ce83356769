#pragma once

#include "gld/cameras/camera.h"

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// One camera of a cameras.json file (docs/FILES.md). Paths are relative to the file's folder.
struct CameraRecord {
  std::string name;  // unique in the file, "view_03"
  std::string role;  // "source", "target" or empty
  Camera camera;
  std::string image;      // empty when there is none
  std::string depth;      // planar depth, 16-bit PNG or npy; empty when there is none
  double depth_unit = 0;  // length per step of a PNG, in the unit of the poses; 0 without one
};

struct CameraList {
  bool metric = false;  // poses and depth are in metres
  std::string points;   // sparse points in the world, (points, 3) as npy; empty when there are none
  std::vector<CameraRecord> records;
};

// Beside cameras.json where depth maps have another size than images: their cameras, by the same names, with depth and
// without images.
inline constexpr const char* kDepthCamerasFile = "depth_cameras.json";

// The format that we read and write ourselves. Numbers keep every bit; additional keys are ignored. Throws Error that
// names the file, the frame and the key: not JSON, a missing or mistyped key, two frames of one name, no frame, or a
// camera that datasets/scenes/frame_checks.h refuses.
CameraList read_cameras_json(const std::filesystem::path& file);

std::string cameras_json_text(const CameraList& cameras);
// Writes atomically; refuses the same cameras.
void write_cameras_json(const std::filesystem::path& file, const CameraList& cameras);

}  // namespace gld
