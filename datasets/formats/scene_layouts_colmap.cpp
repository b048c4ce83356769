// Layouts around a COLMAP model: COLMAP binary and text, ETH3D.
#include "datasets/formats/colmap_model.h"
#include "datasets/formats/depth_files.h"
#include "datasets/formats/scene_layouts.h"
#include "datasets/images/image_file.h"

#include <Eigen/Geometry>

namespace gld {
namespace {

ColmapModel model_of(const Scene& scene, const std::string& image_prefix, const std::string& extension) {
  ColmapModel model;
  model.points_in_world = scene.points_in_world;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const Frame& frame = scene.frames[i];
    const Eigen::Matrix3d& k = frame.camera.intrinsics;
    const auto id = static_cast<int64_t>(i) + 1;
    model.cameras[id] = {
        "PINHOLE", frame.camera.width, frame.camera.height, {k(0, 0), k(1, 1), k(0, 2), k(1, 2)}};
    const Eigen::Isometry3d pose = frame.camera.camera_from_world();
    ColmapImage image;
    image.rotation = Eigen::Quaterniond(pose.linear());
    image.translation = pose.translation();
    image.camera_id = id;
    image.name = image_prefix;
    image.name += frame.name;
    image.name += extension;
    model.images.push_back(image);
  }
  return model;
}

void write_colmap(const Scene& scene, const std::filesystem::path& folder, ColmapForm form) {
  const auto model_folder = folder / "sparse" / "0";
  std::filesystem::create_directories(model_folder);
  std::filesystem::create_directories(folder / "images");
  for (const Frame& frame : scene.frames) write_png(folder / "images" / (frame.name + ".png"), frame.image());
  write_colmap_model(model_folder, model_of(scene, "", ".png"), form);
}

}  // namespace

void write_colmap_layout(const Scene& scene, const std::filesystem::path& folder) {
  write_colmap(scene, folder, ColmapForm::kBinary);
}

void write_colmap_text_layout(const Scene& scene, const std::filesystem::path& folder) {
  write_colmap(scene, folder, ColmapForm::kText);
}

void write_eth3d_layout(const Scene& scene, const std::filesystem::path& folder) {
  const auto model_folder = folder / "dslr_calibration_jpg";
  const auto images = folder / "images" / "dslr_images";
  const auto depths = folder / "ground_truth_depth" / "dslr_images";
  for (const auto& path : {model_folder, images, depths}) std::filesystem::create_directories(path);
  for (const Frame& frame : scene.frames) {
    write_jpeg(images / (frame.name + ".JPG"), frame.image(), 98);
    if (frame.has_depth()) write_depth_raw(depths / (frame.name + ".JPG"), frame.depth());
  }
  write_colmap_model(model_folder, model_of(scene, "dslr_images/", ".JPG"), ColmapForm::kText);
}

}  // namespace gld
