#pragma once

#include "datasets/scenes/scene.h"
#include "gld/base/options.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace gld {

enum class BrokenFrames {
  kRefuse,  // the first one is an Error: for commands on one scene
  kSkip,    // left out, counted in Scene::broken_frames, its sentence kept as a warning: for training
};

struct SceneReading : OptionsGroup {
  std::string format = "auto";
  std::string image_folder;  // "images_4"; empty: chosen by the reader
  std::string part;          // HyperSim's camera "cam_00", a listed pair; empty: the only one
  BrokenFrames broken_frames = BrokenFrames::kRefuse;

  void visit(FieldVisitor& visitor) override;
  void check() const override;  // the format exists
};

// One on-disk format. Each converts to OpenCV conventions at its own door.
class SceneReader {
 public:
  virtual ~SceneReader() = default;
  virtual std::string name() const = 0;    // "colmap"
  virtual std::string marker() const = 0;  // what makes a folder recognised, in words
  virtual bool recognises(const std::filesystem::path& path) const = 0;
  // Returns the scenes a recognised folder holds; {""} unless the format keeps several trajectories or pairs in one
  // folder.
  virtual std::vector<std::string> parts(const std::filesystem::path& path) const;
  virtual Scene read(const std::filesystem::path& path, const SceneReading& reading) const = 0;
};

// Returns them in the order in which auto-detection asks them.
const std::vector<const SceneReader*>& scene_readers();
std::vector<std::string> scene_format_names();

// Returns the reader of that name, or throws Error with the nearest one.
const SceneReader& scene_reader(const std::string& name);

// Returns the first reader that recognises the path, or nullptr.
const SceneReader* detect_scene_format(const std::filesystem::path& path);

// Reads one scene. Never returns a scene without frames. Errors name the formats when none is recognised.
Scene open_scene(const std::filesystem::path& path, const SceneReading& reading = {});

// Where a scene lies: a folder or file and the part of it.
struct SceneLocation {
  std::filesystem::path path;
  std::string part;
};

// Returns all scenes at or below root (at most depth 4), sorted by path; throws Error when there are none.
std::vector<SceneLocation> list_scenes(const std::filesystem::path& root, const SceneReading& reading = {});

}  // namespace gld
