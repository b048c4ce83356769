#pragma once

#include "datasets/formats/scene_reader.h"

#include <cstdint>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {

// RealEstate10K has a text file per clip (first line the video's address, then rows of time in microseconds, fx fy cx
// cy divided by width and height, two unused values, 3x4 camera_from_world, OpenCV) and the clip's frames as images.
// The scene is the text file, or a folder that holds exactly one. Frames are looked for in CLIP/, frames/CLIP/ and
// images/CLIP/ beside the file and beside its folder, and directly beside it when it is alone. Their names are the
// times (micro- or milliseconds), or, when there are as many images as rows, they are taken in order. Rows without an
// image are counted as missing.
class Re10kReader : public SceneReader {
 public:
  std::string name() const override { return "re10k"; }
  std::string marker() const override { return "a camera text file that starts with a video's address"; }
  bool recognises(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

// One row of a camera file.
struct Re10kRow {
  int64_t time = 0;  // microseconds
  Eigen::Vector4d relative_intrinsics =
      Eigen::Vector4d::Zero();  // fx / width, fy / height, cx / width, cy / height
  Eigen::Matrix4d camera_from_world = Eigen::Matrix4d::Identity();
  std::string where;
};
std::vector<Re10kRow> read_re10k_rows(const std::filesystem::path& file);

}  // namespace gld
