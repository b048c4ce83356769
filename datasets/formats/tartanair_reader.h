#pragma once

#include "datasets/formats/scene_reader.h"

namespace gld {

// Reads TartanAir: image_left/*.png, depth_left/*_depth.npy (float32 metres, planar) and pose_left.txt, one row an
// image: tx ty tz qx qy qz qw, world from camera in north-east-down axes (x forward, y right, z down). Focal length is
// 320 and the centre (320, 240) at 640x480, scaled for other sizes. The world keeps its north-east-down axes.
class TartanAirReader : public SceneReader {
 public:
  std::string name() const override { return "tartanair"; }
  std::string marker() const override { return "pose_left.txt"; }
  bool recognises(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

}  // namespace gld
