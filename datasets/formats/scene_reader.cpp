#include "datasets/formats/scene_reader.h"

#include "datasets/formats/cameras_json_reader.h"
#include "datasets/formats/colmap_reader.h"
#include "datasets/formats/eth3d_reader.h"
#include "datasets/formats/file_listing.h"
#include "datasets/formats/hypersim_reader.h"
#include "datasets/formats/nerfstudio_reader.h"
#include "datasets/formats/npz_reader.h"
#include "datasets/formats/re10k_reader.h"
#include "datasets/formats/scannet_reader.h"
#include "datasets/formats/tartanair_reader.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"

#include <algorithm>

namespace gld {
namespace {

constexpr int kDeepestScene = 4;

std::string joined(const std::vector<std::string>& texts, const std::string& separator) {
  std::string result;
  for (const auto& text : texts) result += (result.empty() ? "" : separator) + text;
  return result;
}

void collect_scenes(const std::filesystem::path& path, const SceneReading& reading, int depth,
                    std::vector<SceneLocation>& found) {
  const SceneReader* reader = nullptr;
  if (reading.format == "auto") {
    reader = detect_scene_format(path);
  } else if (scene_reader(reading.format).recognises(path)) {
    reader = &scene_reader(reading.format);
  }
  if (reader != nullptr) {
    for (const std::string& part : reader->parts(path)) {
      if (reading.part.empty() || part == reading.part) found.push_back({path, part});
    }
    return;
  }
  if (depth == kDeepestScene) return;
  for (const auto& folder : list_folders(path)) collect_scenes(folder, reading, depth + 1, found);
  // RealEstate10K keeps one text file a scene in one folder.
  for (const auto& file : list_files(path, ".txt")) collect_scenes(file, reading, kDeepestScene, found);
}

}  // namespace

void SceneReading::visit(FieldVisitor& visitor) {
  visitor.text({"format", "layout of the scene: auto or " + joined(scene_format_names(), ", ")}, format);
  visitor.text(
      {"image_folder", "folder of images inside the scene, such as images_4; empty: chosen by the reader"},
      image_folder);
  visitor.text({"part", "which trajectory or pair of a scene that has several, such as cam_00"}, part);
  visit_choice(visitor,
               {"broken_frames", "refuse a scene with a broken frame, or skip and count such frames"},
               broken_frames, {"refuse", "skip"});
}

void SceneReading::check() const {
  if (format != "auto") scene_reader(format);
}

std::vector<std::string> SceneReader::parts(const std::filesystem::path&) const { return {std::string()}; }

const std::vector<const SceneReader*>& scene_readers() {
  static const CamerasJsonReader cameras_json;
  static const ScannetPairsReader scannet_pairs;
  static const ScannetReader scannet;
  static const NpzReader npz;
  static const NerfstudioReader nerfstudio;
  static const HypersimReader hypersim;
  static const TartanAirReader tartanair;
  static const Eth3dReader eth3d;
  static const ColmapReader colmap;
  static const Re10kReader re10k;
  static const std::vector<const SceneReader*> readers{&cameras_json, &npz,   &nerfstudio, &hypersim,
                                                       &tartanair,    &eth3d, &colmap,     &scannet_pairs,
                                                       &scannet,      &re10k};
  return readers;
}

std::vector<std::string> scene_format_names() {
  std::vector<std::string> names;
  for (const SceneReader* reader : scene_readers()) names.push_back(reader->name());
  return names;
}

const SceneReader& scene_reader(const std::string& name) {
  for (const SceneReader* reader : scene_readers()) {
    if (reader->name() == name) return *reader;
  }
  const std::string nearest = nearest_name(name, scene_format_names());
  fail({"--format", "auto or " + joined(scene_format_names(), ", "), "\"" + name + "\"",
        nearest.empty() ? "choose one of them" : "did you mean \"" + nearest + "\"?"});
}

const SceneReader* detect_scene_format(const std::filesystem::path& path) {
  const auto& readers = scene_readers();
  const auto found = std::find_if(readers.begin(), readers.end(),
                                  [&](const SceneReader* reader) { return reader->recognises(path); });
  return found == readers.end() ? nullptr : *found;
}

namespace {

[[noreturn]] void fail_missing_scene(const std::filesystem::path& path) {
  fail({path.string(), "a scene's folder", "nothing", "check the path"});
}

std::string known_markers() {
  std::vector<std::string> markers;
  for (const SceneReader* known : scene_readers())
    markers.push_back(known->marker() + " (" + known->name() + ")");
  return joined(markers, ", ");
}

void refuse_bare_photographs(const std::filesystem::path& path) {
  const auto photographs = list_images(path);
  if (photographs.empty()) return;
  fail({path.string(), "images with cameras (one of: " + known_markers() + ")",
        std::to_string(photographs.size()) + " photographs without cameras",
        "let the model estimate them with gld sample --photos " + path.string() +
            ", or let COLMAP: colmap automatic_reconstructor --workspace_path " + path.string() +
            "_colmap --image_path " + path.string() + ", then put its sparse/0 beside the images"});
}

}  // namespace

Scene open_scene(const std::filesystem::path& path, const SceneReading& reading) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) {
    fail_missing_scene(path);
  }
  if (reading.format != "auto") return scene_reader(reading.format).read(path, reading);
  const SceneReader* reader = detect_scene_format(path);
  if (reader != nullptr) return reader->read(path, reading);

  std::vector<SceneLocation> below;
  collect_scenes(path, reading, 0, below);
  if (below.size() == 1) {
    SceneReading only = reading;
    only.part = below.front().part;
    return detect_scene_format(below.front().path)->read(below.front().path, only);
  }
  if (!below.empty()) {
    fail({path.string(), "one scene", "a folder of " + std::to_string(below.size()) + " scenes",
          "name one of them, such as " + below.front().path.string()});
  }
  refuse_bare_photographs(path);
  fail({path.string(), "one of: " + known_markers(), "none of them",
        "check the folder; gld check-data --format forces a layout and says what is missing"});
}

std::vector<SceneLocation> list_scenes(const std::filesystem::path& root, const SceneReading& reading) {
  std::error_code error;
  if (!std::filesystem::exists(root, error)) fail_missing_scene(root);
  std::vector<SceneLocation> found;
  collect_scenes(root, reading, 0, found);
  // It knows what is missing of it.
  if (found.empty() && reading.format != "auto") {
    for (const std::string& part : scene_reader(reading.format).parts(root)) found.push_back({root, part});
  }
  if (found.empty()) {
    refuse_bare_photographs(root);
    fail({root.string(), "at least one scene", "none",
          reading.format == "auto"
              ? "check the folder; gld check-data --format forces a layout and says what is missing"
              : "check the folder, or choose another --format"});
  }
  return found;
}

}  // namespace gld
