// Layouts that keep each camera beside its image or in one JSON list: cameras-json, npz, nerfstudio.
#include "datasets/formats/cameras_json.h"
#include "datasets/formats/depth_files.h"
#include "datasets/formats/nerfstudio_writer.h"
#include "datasets/formats/scene_layouts.h"
#include "datasets/images/image_file.h"
#include "gld/base/atomic_file.h"
#include "gld/files/npy.h"

#include <vector>

#include <Eigen/Core>

namespace gld {
namespace {

template <int Size>
NpyArray square_array(const Eigen::Matrix<double, Size, Size>& matrix) {
  const Eigen::Matrix<double, Size, Size, Eigen::RowMajor> rows = matrix;
  return npy_from_doubles({Size, Size}, rows.data());
}

// images/NAME.png and, where there is depth, depth/NAME.npy.
struct WrittenFrame {
  std::string image;
  std::string depth;
};
WrittenFrame write_pixels(const Frame& frame, const std::filesystem::path& folder) {
  WrittenFrame written;
  written.image = "images/" + frame.name + ".png";
  write_png(folder / written.image, frame.image());
  if (!frame.has_depth()) return written;
  written.depth = "depth/" + frame.name + ".npy";
  write_depth_npy(folder / written.depth, frame.depth());
  return written;
}

}  // namespace

void write_cameras_json_layout(const Scene& scene, const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder / "images");
  std::filesystem::create_directories(folder / "depth");
  CameraList cameras;
  cameras.metric = scene.metric;
  for (const Frame& frame : scene.frames) {
    const WrittenFrame written = write_pixels(frame, folder);
    CameraRecord record;
    record.name = frame.name;
    record.camera = frame.camera;
    record.image = written.image;
    record.depth = written.depth;
    cameras.records.push_back(record);
  }
  write_cameras_json(folder / "cameras.json", cameras);
}

void write_npz_layout(const Scene& scene, const std::filesystem::path& folder) {
  const auto images = folder / "nerfstudio" / "images_4";
  std::filesystem::create_directories(images);
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const Frame& frame = scene.frames[i];
    write_png(images / (frame.name + ".png"), frame.image());
    write_npz(images / (frame.name + ".npz"),
              {{"intrinsic", square_array<3>(frame.camera.intrinsics)},
               {"pose", square_array<4>(frame.camera.world_from_camera.matrix())}});
  }
  write_file_atomically(folder / "nerfstudio" / "transforms.json", "{\"frames\":[]}\n");
}

void write_nerfstudio_layout(const Scene& scene, const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder / "images");
  std::filesystem::create_directories(folder / "depth");
  Transforms transforms;
  transforms.depth_unit = 1;  // .npy has the unit of the poses, which nerfstudio takes for millimetres
  for (const Frame& frame : scene.frames) {
    const WrittenFrame written = write_pixels(frame, folder);
    transforms.frames.push_back({written.image, written.depth, frame.camera});
  }
  write_transforms_json(folder / "transforms.json", transforms);
}

}  // namespace gld
