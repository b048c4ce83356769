#pragma once

#include "datasets/formats/scene_reader.h"

namespace gld {

// A folder with cameras.json (datasets/formats/cameras_json.h) and the images it names.
class CamerasJsonReader : public SceneReader {
 public:
  std::string name() const override { return "cameras-json"; }
  std::string marker() const override { return "cameras.json"; }
  bool recognises(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

}  // namespace gld
