#include "datasets/formats/colmap_reader.h"

#include "datasets/formats/colmap_model.h"
#include "datasets/formats/file_listing.h"
#include "datasets/formats/frame_pixels.h"
#include "gld/base/error.h"

#include <optional>

namespace gld {
namespace {

// images_N may hold another file type than the model names.
std::filesystem::path find_colmap_image(const std::filesystem::path& folder, const std::string& name,
                                        const std::string& where) {
  auto file = inside(folder, name, where);
  if (is_file(file)) return file;
  return find_image(file.parent_path(), file.stem().string());
}

// Returns the scene around a model whose own folder was given, such as SCENE/sparse/0: the nearest folder with images,
// or the path itself where there is none.
std::filesystem::path scene_around(const std::filesystem::path& path, const std::string& image_folder) {
  auto folder = std::filesystem::absolute(path).lexically_normal();
  if (!folder.has_filename()) folder = folder.parent_path();
  constexpr int kDeepestModel = 3;  // SCENE/colmap/sparse/0
  for (int depth = 0; depth <= kDeepestModel; ++depth, folder = folder.parent_path()) {
    const bool found =
        image_folder.empty() ? !find_image_folder(folder, "").empty() : is_folder(folder / image_folder);
    if (found) return depth == 0 ? path : folder;
  }
  return path;
}

}  // namespace

bool ColmapReader::recognises(const std::filesystem::path& path) const {
  return !find_colmap_model(path).folder.empty();
}

Scene ColmapReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  const ColmapLocation location = find_colmap_model(path);
  if (location.folder.empty()) {
    fail({path.string(), marker(), "none", "check the folder or choose another format"});
  }
  const ColmapModel model = read_colmap_model(location.folder, location.form);
  const auto scene = location.folder == path ? scene_around(path, reading.image_folder) : path;
  const auto images = find_image_folder(scene, reading.image_folder);
  if (images.empty()) {
    fail({scene.string(), "a folder of images beside the model (images or images_N)", "none",
          "put the images there, or name a folder inside the scene with --image-folder"});
  }
  SceneBuilder builder(name(), scene, reading);
  FrameMaker maker;
  for (const ColmapImage& image : model.images) {
    const std::string where = location.folder.string() + " " + image.name;
    builder.add(where, [&]() -> std::optional<Frame> {
      const auto file = find_colmap_image(images, image.name, where);
      if (file.empty()) {
        builder.add_missing(images / image.name);
        return std::nullopt;
      }
      return maker.make(colmap_record(model, image, file, where));
    });
  }
  builder.scene().points_in_world = model.points_in_world;
  builder.warn(maker.crop_note());
  return builder.finish();
}

}  // namespace gld
