#include "datasets/formats/hypersim_reader.h"

#include "datasets/formats/depth_files.h"
#include "datasets/formats/file_listing.h"
#include "datasets/formats/hypersim_camera.h"
#include "datasets/formats/scene_builder.h"
#include "datasets/images/decoded_pixels.h"
#include "datasets/images/image_file.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/error.h"
#include "gld/files/hdf5_array.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

constexpr int64_t kMostKeyframes = 1'000'000;

void check_shape(const Hdf5Array& array, const std::vector<int64_t>& shape,
                 const std::filesystem::path& file) {
  if (array.shape == shape) return;
  const auto text = [](const std::vector<int64_t>& extents) {
    return fmt::format("({})", fmt::join(extents, ", "));
  };
  fail({file.string(), "shape " + text(shape), text(array.shape), "check that the files belong together"});
}

Image read_colour(const std::filesystem::path& file) {
  if (file.extension() != ".hdf5") return read_image(file);
  const Hdf5Array array = read_hdf5_array(file, "dataset", 3 * kMostPixels);
  if (array.shape.size() != 3) check_shape(array, {768, 1024, 3}, file);
  check_shape(array, {array.shape[0], array.shape[1], 3}, file);
  check_picture_size(array.shape[1], array.shape[0], file.string());
  return tone_mapped(array.values, array.shape[1], array.shape[0]);
}

DepthMap read_distance(const std::filesystem::path& file) {
  const Hdf5Array array = read_hdf5_array(file, "dataset", kMostPixels);
  if (array.shape.size() != 2) check_shape(array, {768, 1024}, file);
  check_picture_size(array.shape[1], array.shape[0], file.string());
  DepthMap distance;
  distance.height = array.shape[0];
  distance.width = array.shape[1];
  distance.metres = array.values;
  clear_unknown(distance);
  return distance;
}

// Returns the best file of a frame's colour, or empty.
std::filesystem::path colour_file(const std::filesystem::path& images, const std::string& camera,
                                  int64_t frame) {
  for (const auto& [folder, ending] :
       {std::pair("final_hdf5", "color.hdf5"), std::pair("final_preview", "tonemap.jpg"),
        std::pair("final_preview", "color.jpg")}) {
    auto file =
        images / fmt::format("scene_{}_{}", camera, folder) / fmt::format("frame.{:04}.{}", frame, ending);
    if (is_file(file)) return file;
  }
  return {};
}

}  // namespace

Image tone_mapped(const std::vector<float>& linear_rgb, int64_t width, int64_t height) {
  std::vector<float> brightness;
  for (size_t i = 0; i + 2 < linear_rgb.size(); i += 3) {
    const float value = 0.3F * linear_rgb[i] + 0.59F * linear_rgb[i + 1] + 0.11F * linear_rgb[i + 2];
    if (std::isfinite(value)) brightness.push_back(value);
  }
  double scale = 1;
  if (!brightness.empty()) {
    const auto rank = static_cast<std::ptrdiff_t>(0.9 * static_cast<double>(brightness.size() - 1));
    std::nth_element(brightness.begin(), brightness.begin() + rank, brightness.end());
    const double reference = brightness[static_cast<size_t>(rank)];
    scale = reference > 1e-4 ? std::pow(0.8, 2.2) / reference : 0;
  }
  Image image(width, height);
  for (size_t i = 0; i < image.rgb.size(); ++i) {
    const double value = std::isfinite(linear_rgb[i]) ? std::max(0.0, scale * linear_rgb[i]) : 1;
    image.rgb[i] = static_cast<uint8_t>(std::lround(255 * std::min(1.0, std::pow(value, 1 / 2.2))));
  }
  return image;
}

std::map<int64_t, Eigen::Matrix4d> read_hypersim_trajectory(const std::filesystem::path& folder,
                                                            double metres_per_asset_unit) {
  const Hdf5Array positions =
      read_hdf5_array(folder / "camera_keyframe_positions.hdf5", "dataset", 3 * kMostKeyframes);
  const int64_t count = positions.shape.empty() ? 0 : positions.shape[0];
  check_shape(positions, {count, 3}, folder / "camera_keyframe_positions.hdf5");
  const auto orientation_file = folder / "camera_keyframe_orientations.hdf5";
  const Hdf5Array orientations = read_hdf5_array(orientation_file, "dataset", 9 * kMostKeyframes);
  check_shape(orientations, {count, 3, 3}, orientation_file);
  std::vector<float> frames;
  const auto index_file = folder / "camera_keyframe_frame_indices.hdf5";
  if (is_file(index_file)) {
    const Hdf5Array indices = read_hdf5_array(index_file, "dataset", kMostKeyframes);
    check_shape(indices, {count}, index_file);
    frames = indices.values;
  }
  std::map<int64_t, Eigen::Matrix4d> poses;
  for (int64_t i = 0; i < count; ++i) {
    Eigen::Matrix4d pose = Eigen::Matrix4d::Identity();
    for (int k = 0; k < 9; ++k) pose(k / 3, k % 3) = orientations.values[static_cast<size_t>(9 * i + k)];
    for (int k = 0; k < 3; ++k)
      pose(k, 3) = positions.values[static_cast<size_t>(3 * i + k)] * metres_per_asset_unit;
    pose.col(1) *= -1;
    pose.col(2) *= -1;
    const float number = frames.empty() ? static_cast<float>(i) : frames[static_cast<size_t>(i)];
    if (!(number >= 0 && number < 1e9F)) {
      fail({index_file.string(), "numbers of frames, 0 or more", fmt::format("{} at place {}", number, i),
            "copy or download it again"});
    }
    poses[frames.empty() ? i : std::lround(number)] = pose;
  }
  return poses;
}

bool HypersimReader::recognises(const std::filesystem::path& path) const { return !parts(path).empty(); }

std::vector<std::string> HypersimReader::parts(const std::filesystem::path& path) const {
  std::vector<std::string> cameras;
  for (const auto& folder : list_folders(path / "_detail")) {
    if (is_file(folder / "camera_keyframe_positions.hdf5")) {
      cameras.push_back(folder.filename().string());
    }
  }
  return cameras;
}

Scene HypersimReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  const auto cameras = parts(path);
  std::string camera = reading.part;
  if (camera.empty() && cameras.size() == 1) camera = cameras.front();
  if (std::find(cameras.begin(), cameras.end(), camera) == cameras.end()) {
    fail({path.string(), fmt::format("one of the cameras {}", fmt::join(cameras, ", ")),
          camera.empty() ? "no choice" : camera, "choose one with --part"});
  }
  const auto detail = path / "_detail" / camera;
  const HypersimSettings settings = read_hypersim_settings(path);
  const auto lens = std::make_shared<const HypersimLens>(settings, path.string());
  SceneBuilder builder(name(), path, reading);
  for (const auto& [frame_number, pose] : read_hypersim_trajectory(detail, settings.metres_per_asset_unit)) {
    const auto colour = colour_file(path / "images", camera, frame_number);
    const auto depth = path / "images" / fmt::format("scene_{}_geometry_hdf5", camera) /
                       fmt::format("frame.{:04}.depth_meters.hdf5", frame_number);
    const bool has_depth = is_file(depth);
    if (colour.empty() && !has_depth) {
      builder.add_missing(path / "images" / fmt::format("scene_{}_final_hdf5", camera) /
                          fmt::format("frame.{:04}.color.hdf5", frame_number));
      continue;
    }
    const std::string where = fmt::format("{} frame {}", detail.string(), frame_number);
    builder.add(where, [&, number = frame_number, matrix = pose]() -> std::optional<Frame> {
      Frame frame;
      frame.name = fmt::format("frame.{:04}", number);
      frame.camera = lens->camera();
      frame.camera.world_from_camera = checked_pose(matrix, where);
      frame.camera.world_from_camera.linear() *= lens->stored_from_camera();
      frame.image_file = colour;
      if (!colour.empty()) frame.load_image = [lens, colour] { return lens->image(read_colour(colour)); };
      if (has_depth) frame.load_depth = [lens, depth] { return lens->planar_depth(read_distance(depth)); };
      return frame;
    });
  }
  builder.scene().name += "_" + camera;
  builder.scene().metric = true;
  return builder.finish();
}

}  // namespace gld
