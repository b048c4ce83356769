#include "datasets/formats/npz_reader.h"

#include "datasets/formats/file_listing.h"
#include "datasets/formats/frame_pixels.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/error.h"
#include "gld/files/npy.h"

#include <algorithm>
#include <optional>

namespace gld {
namespace {

std::filesystem::path npz_beside(const std::filesystem::path& image) {
  return std::filesystem::path(image).replace_extension(".npz");
}

// A few images tell: a folder may hold thousands without any camera file.
bool has_camera_files(const std::filesystem::path& folder) {
  const auto images = list_images(folder);
  const auto few = images.begin() + static_cast<std::ptrdiff_t>(std::min<size_t>(images.size(), 16));
  return std::any_of(images.begin(), few,
                     [](const std::filesystem::path& image) { return is_file(npz_beside(image)); });
}

// Returns the folder that holds images and .npz, or empty.
std::filesystem::path frame_folder(const std::filesystem::path& path, const std::string& asked_for) {
  for (const auto& scene : {path, path / "nerfstudio"}) {
    if (asked_for.empty()) {
      std::vector<std::filesystem::path> candidates{scene, scene / "images"};
      for (const auto& folder : list_folders(scene)) {
        if (folder.filename().string().rfind("images_", 0) == 0) candidates.push_back(folder);
      }
      for (const auto& folder : candidates) {
        if (has_camera_files(folder)) return folder;
      }
    } else if (is_folder(inside(scene, asked_for, "image_folder"))) {
      return scene / asked_for;
    }
  }
  return {};
}

Eigen::MatrixXd matrix_of(const NpzFile& file, const std::string& key, Eigen::Index size,
                          const std::string& where) {
  const NpyArray array = file.read(key, static_cast<uint64_t>(size * size) * sizeof(double));
  if (array.shape != std::vector<int64_t>{size, size}) {
    std::string shape;
    for (int64_t extent : array.shape) shape += (shape.empty() ? "" : ", ") + std::to_string(extent);
    fail({where, key + " of shape (" + std::to_string(size) + ", " + std::to_string(size) + ")",
          "(" + shape + ")", "check the file"});
  }
  const std::vector<double> values = array.to_doubles();
  return Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(
      values.data(), size, size);
}

}  // namespace

bool NpzReader::recognises(const std::filesystem::path& path) const {
  return !frame_folder(path, {}).empty();
}

Scene NpzReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  const auto folder = frame_folder(path, reading.image_folder);
  if (folder.empty()) {
    fail({path.string(), marker(), "none", "check the folder or choose another format"});
  }
  SceneBuilder builder(name(), path, reading);
  FrameMaker maker;
  for (const auto& image : list_images(folder)) {
    const auto file = npz_beside(image);
    if (!is_file(file)) {
      builder.add_missing(file);
      continue;
    }
    builder.add(file.string(), [&]() -> std::optional<Frame> {
      const NpzFile arrays = NpzFile::open(file);
      FrameRecord record;
      record.name = image.stem().string();
      record.image_file = image;
      record.intrinsics = matrix_of(arrays, "intrinsic", 3, file.string());
      record.world_from_camera =
          checked_pose(Eigen::Matrix4d(matrix_of(arrays, "pose", 4, file.string())), file.string());
      return maker.make(record);
    });
  }
  return builder.finish();
}

}  // namespace gld
