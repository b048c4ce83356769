#pragma once

#include "gld/cameras/camera.h"

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// What a transforms.json of nerfstudio says. Paths are relative to the file.
struct TransformsFrame {
  std::string image;
  std::string depth;  // empty where there is none
  Camera camera;      // of the image
};

struct Transforms {
  std::vector<TransformsFrame> frames;
  double depth_unit = 0;    // length of a step of 16-bit depth, as "depth_unit_scale_factor"; 0: left out
  std::string point_cloud;  // "ply_file_path", in the world of the cameras; empty: left out
  std::vector<std::pair<std::string, std::string>> comments;  // texts under "gld", which others leave alone
};

// Poses are those of OpenGL cameras (x right, y up, looking along -z), in the same world. The file is written
// atomically.
void write_transforms_json(const std::filesystem::path& file, const Transforms& transforms);

}  // namespace gld
