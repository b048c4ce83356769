#include "infer/sample/photo_scene.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/formats/file_listing.h"
#include "datasets/images/image_file.h"
#include "datasets/images/image_probe.h"
#include "datasets/scenes/resize_crop.h"
#include "gld/base/error.h"
#include "infer/export/image_export.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/pipeline/geometry_of_pictures.h"
#include "infer/pipeline/scene_request.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>
#include <utility>

namespace gld {
namespace {

std::vector<std::filesystem::path> photograph_files(const std::vector<std::string>& photos) {
  std::vector<std::filesystem::path> files;
  for (const std::string& photo : photos) {
    const std::filesystem::path path = photo;
    if (std::filesystem::is_regular_file(path)) {
      files.push_back(path);
      continue;
    }
    const auto listed = list_images(path);
    if (listed.empty()) {
      fail({"--photos", "photographs, or folders of them", "'" + photo + "', which has none",
            "check the name"});
    }
    files.insert(files.end(), listed.begin(), listed.end());
  }
  return files;
}

// Numbers photographs by their lens.
class LensNumbers {
 public:
  explicit LensNumbers(PhotoLens lens) : lens_(lens) {}
  int64_t of(const Photograph& photograph) {
    if (lens_ == PhotoLens::kShared) return 0;
    if (lens_ == PhotoLens::kOwn) return next_++;
    // A camera held upright turns its pictures.
    const std::pair sides(std::min(photograph.width, photograph.height),
                          std::max(photograph.width, photograph.height));
    const auto [entry, is_new] = by_sides_.try_emplace(sides, next_);
    if (is_new) ++next_;
    return entry->second;
  }

 private:
  PhotoLens lens_;
  int64_t next_ = 0;
  std::map<std::pair<int64_t, int64_t>, int64_t> by_sides_;
};

std::vector<std::string> names_of(const Scene& scene) {
  std::vector<std::string> names;
  for (const Frame& frame : scene.frames) names.push_back(frame.name);
  return names;
}

}  // namespace

std::vector<Photograph> list_photographs(const std::vector<std::string>& files_and_folders) {
  std::vector<Photograph> photographs;
  std::set<std::string> names;
  for (const auto& file : photograph_files(files_and_folders)) {
    Photograph photograph;
    photograph.name = file.stem().string();
    photograph.file = file;
    if (!names.insert(photograph.name).second) {
      fail({"--photos", "photographs of different names", "'" + photograph.name + "' twice",
            "rename one of them"});
    }
    const ImageFileInfo header = probe_image_file(file);
    photograph.width = header.turned() ? header.height : header.width;
    photograph.height = header.turned() ? header.width : header.height;
    photographs.push_back(std::move(photograph));
  }
  return photographs;
}

Scene scene_before_cameras(const std::vector<Photograph>& photographs) {
  Scene scene;
  scene.name = "photographs";
  scene.format = "photos";
  for (const Photograph& photograph : photographs) {
    Frame frame;
    frame.name = photograph.name;
    frame.image_file = photograph.file;
    frame.camera.width = photograph.width;
    frame.camera.height = photograph.height;
    const auto width = static_cast<double>(photograph.width), height = static_cast<double>(photograph.height);
    frame.camera.intrinsics(0, 0) = frame.camera.intrinsics(1, 1) = std::max(width, height);
    frame.camera.intrinsics(0, 2) = width / 2;
    frame.camera.intrinsics(1, 2) = height / 2;
    frame.camera.world_from_camera.translation().x() = static_cast<double>(scene.frames.size());
    scene.frames.push_back(std::move(frame));
  }
  return scene;
}

PhotoScene photo_scene(const std::vector<Photograph>& taken, PhotoLens lens, const ImageSize& size,
                       const PipelineModels& geometry, const torch::Device& device, StageRecords& stages) {
  PhotoScene made;
  made.scene = scene_before_cameras(taken);
  Scene& scene = made.scene;
  std::vector<PhotographLens> lenses;
  torch::Tensor photographs;
  GeometryOutput seen;
  stages.run(kPhotoCamerasStage, [&] {
    LensNumbers numbers(lens);
    // One photograph at a time: as taken, they may be a hundred times as large as what the model sees.
    for (const Photograph& photograph : taken) {
      const Image original = read_image(photograph.file, ImageOrientation::kUpright);
      const ResizeCrop plan = plan_resize_crop(original.width, original.height, size);
      made.images.push_back(resize_crop(original, plan));
      lenses.push_back(
          {numbers.of(photograph), static_cast<double>(std::max(original.width, original.height)) *
                                       static_cast<double>(plan.resized_width) /
                                       static_cast<double>(plan.window_width)});
    }
    photographs = stacked(made.images);
    seen = geometry_of_pictures(geometry, photographs, GeometryMaps::kDepthAndRays, device);
    require_finite_geometry(seen, "the geometry of the photographs");
  });
  stages.run("fitting cameras", [&] { made.found = photo_cameras(seen, photographs, lenses); });
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    scene.frames[i].camera = made.found.cameras[i];
    scene.frames[i].load_image = [image = made.images[i]] { return image; };
  }
  made.text = photo_cameras_text(made.found, names_of(scene));
  for (const std::string& doubt : made.found.doubts()) {
    scene.warnings.push_back("the cameras estimated from the photographs are not sure: " + doubt);
  }
  return made;
}

void write_photo_scene(RunFolder& run, const PhotoScene& photos, const Provenance& provenance) {
  const auto folder = run.subfolder("photo_scene");
  CameraList list;
  for (size_t i = 0; i < photos.images.size(); ++i) {
    CameraRecord record;
    record.name = photos.scene.frames[i].name;
    record.camera = photos.scene.frames[i].camera;
    record.image = record.name + ".png";
    export_image(folder / record.image, photos.images[i], provenance);
    list.records.push_back(record);
  }
  write_cameras_json(folder / "cameras.json", list);
  run.note("photographs with cameras", "photo_scene");
}

nlohmann::ordered_json photo_scene_json(const PhotoScene& photos) {
  return photo_cameras_json(photos.found, names_of(photos.scene));
}

}  // namespace gld
