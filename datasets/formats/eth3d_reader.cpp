#include "datasets/formats/eth3d_reader.h"

#include "datasets/formats/colmap_model.h"
#include "datasets/formats/depth_files.h"
#include "datasets/formats/file_listing.h"
#include "datasets/formats/frame_pixels.h"
#include "datasets/scenes/undistortion.h"
#include "gld/base/error.h"

#include <map>
#include <memory>
#include <optional>
#include <string>

namespace gld {
namespace {

struct Calibration {
  std::filesystem::path model;
  bool distorted = false;
};

// Returns the calibration whose images are there; without images the first that exists.
Calibration choose_calibration(const std::filesystem::path& path) {
  const Calibration choices[] = {{path / "dslr_calibration_jpg", true},
                                 {path / "dslr_calibration_undistorted", false}};
  const std::filesystem::path images[] = {path / "images" / "dslr_images",
                                          path / "images" / "dslr_images_undistorted"};
  for (int i = 0; i < 2; ++i) {
    if (is_folder(choices[i].model) && !list_images(images[i]).empty()) return choices[i];
  }
  for (const Calibration& choice : choices) {
    if (is_folder(choice.model)) return choice;
  }
  return {};
}

// Cameras of the distorted images by the file name of their image.
using LensesByName = std::map<std::string, LensCamera>;

LensesByName distorted_lenses(const std::filesystem::path& path) {
  LensesByName lenses;
  const auto folder = path / "dslr_calibration_jpg";
  if (!is_file(folder / "images.txt")) return lenses;
  const ColmapModel model = read_colmap_model(folder, ColmapForm::kText);
  for (const ColmapImage& image : model.images) {
    const std::string where = folder.string() + " " + image.name;
    const auto file = std::filesystem::path(image.name).filename();
    const FrameRecord record = colmap_record(model, image, file, where);
    lenses[file.string()] = {record.camera_width, record.camera_height, record.intrinsics, record.lens};
  }
  return lenses;
}

}  // namespace

bool Eth3dReader::recognises(const std::filesystem::path& path) const {
  return !choose_calibration(path).model.empty();
}

Scene Eth3dReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  const Calibration calibration = choose_calibration(path);
  if (calibration.model.empty()) {
    fail({path.string(), marker(), "none", "check the folder or choose another format"});
  }
  const ColmapModel model = read_colmap_model(calibration.model, ColmapForm::kText);
  const LensesByName distorted = calibration.distorted ? LensesByName() : distorted_lenses(path);
  const auto depth_folder = path / "ground_truth_depth" / "dslr_images";
  SceneBuilder builder(name(), path, reading);
  FrameMaker maker;
  for (const ColmapImage& image : model.images) {
    const std::string where = calibration.model.string() + " " + image.name;
    builder.add(where, [&]() -> std::optional<Frame> {
      const auto file = inside(path / "images", image.name, where);
      if (!is_file(file)) {
        builder.add_missing(file);
        return std::nullopt;
      }
      FrameRecord record = colmap_record(model, image, file, where);
      const auto depth = depth_folder / file.filename();
      const auto lens = distorted.find(file.filename().string());
      if (is_file(depth) && calibration.distorted) {
        record.load_depth = [depth, width = record.camera_width, height = record.camera_height] {
          return read_depth_raw(depth, width, height);
        };
      } else if (is_file(depth) && lens != distorted.end()) {
        Camera ideal;
        ideal.width = record.camera_width;
        ideal.height = record.camera_height;
        ideal.intrinsics = record.intrinsics;
        const auto undistorter = make_undistorter(ideal, lens->second);
        record.load_depth = [depth, undistorter, width = lens->second.width, height = lens->second.height] {
          return undistorter->depth(read_depth_raw(depth, width, height));
        };
      }
      return maker.make(record);
    });
  }
  builder.scene().metric = true;
  builder.scene().points_in_world = model.points_in_world;
  builder.warn(maker.crop_note());
  return builder.finish();
}

}  // namespace gld
