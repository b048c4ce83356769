#pragma once

#include "datasets/formats/scene_reader.h"

namespace gld {

// Reads the layout of GLD's published data (DL3DV as its evaluation prepares it): images_N/frame_*.png, each with a
// .npz of the same stem that holds `intrinsic` (3x3, pixels of that very image) and `pose` (4x4 world_from_camera,
// OpenCV). The folder may be the scene, its nerfstudio/ or the image folder itself. Images without .npz are left out
// and counted as missing.
class NpzReader : public SceneReader {
 public:
  std::string name() const override { return "npz"; }
  std::string marker() const override { return "images_N/ with a .npz beside each image"; }
  bool recognises(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

}  // namespace gld
