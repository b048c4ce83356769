#pragma once

#include "datasets/formats/scene_reader.h"

#include <filesystem>
#include <string>

namespace gld {

// Reads a COLMAP model in text or binary form (sparse/0 beside images or images_N, as Mip-NeRF 360 has them).
// Distortion is undone on loading; intrinsics follow images_N. Images of the model that have no file are counted as
// missing.
class ColmapReader : public SceneReader {
 public:
  std::string name() const override { return "colmap"; }
  std::string marker() const override { return "sparse/0 with cameras.bin or cameras.txt"; }
  bool recognises(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

}  // namespace gld
