#include "datasets/formats/scene_builder.h"

#include "datasets/formats/file_listing.h"
#include "datasets/images/image_probe.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/error.h"

#include <cmath>
#include <map>
#include <set>
#include <utility>

namespace gld {

SceneBuilder::SceneBuilder(std::string format, const std::filesystem::path& folder,
                           const SceneReading& reading)
    : broken_frames_(reading.broken_frames) {
  scene_.format = std::move(format);
  scene_.folder = folder;
  scene_.name = is_folder(folder) ? folder_name(folder) : folder.stem().string();
}

void SceneBuilder::add(const std::string& where, const std::function<std::optional<Frame>()>& make) {
  try {
    std::optional<Frame> frame = make();
    if (!frame) return;
    check_frame_camera(frame->camera, where);
    scene_.frames.push_back(*std::move(frame));
  } catch (const Error& error) {
    if (broken_frames_ == BrokenFrames::kRefuse) throw;
    note_gap();
    ++scene_.broken_frames;
    scene_.warnings.emplace_back(error.what());
  }
}

void SceneBuilder::note_gap() {
  if (scene_.missing_files + scene_.broken_frames == 0) first_gap_ = scene_.frames.size();
}

void SceneBuilder::add_missing(const std::filesystem::path& file) {
  note_gap();
  if (scene_.missing_files == 0) first_missing_ = file.string();
  ++scene_.missing_files;
}

void SceneBuilder::warn(const std::string& sentence) {
  if (!sentence.empty()) scene_.warnings.push_back(sentence);
}

Scene SceneBuilder::finish() {
  if (scene_.frames.empty()) {
    std::string found = "none";
    if (scene_.missing_files > 0) {
      found = std::to_string(scene_.missing_files) + " listed files that do not exist, the first " +
              first_missing_;
    } else if (scene_.broken_frames > 0) {
      found = std::to_string(scene_.broken_frames) + " broken ones, the first: " + scene_.warnings.front();
    }
    fail({scene_.folder.string(), "at least one frame", found,
          "check that images and cameras belong together"});
  }
  const int64_t left_out = scene_.missing_files + scene_.broken_frames;
  if (left_out > 0 && first_gap_ < scene_.frames.size()) {
    scene_.warnings.push_back("Frame numbers count the frames that are there: from '" +
                              scene_.frames[first_gap_].name + "' on, which is number " +
                              std::to_string(first_gap_) +
                              ", they are smaller than the place in the listing by up to " +
                              std::to_string(left_out) + ". Names do not shift.");
  }
  if (scene_.missing_files > 0) {
    scene_.warnings.push_back(
        std::to_string(scene_.missing_files) + " of " +
        std::to_string(scene_.missing_files + static_cast<int64_t>(scene_.frames.size())) +
        " listed files do not exist, the first is " + first_missing_ + ".");
  }
  // The number of the next copy is kept for each name: ten thousand frames of one image are not compared with each
  // other.
  std::set<std::string> names;
  std::map<std::string, int64_t> next_copy;
  for (Frame& frame : scene_.frames) {
    if (names.insert(frame.name).second) continue;
    const std::string base = frame.name;
    int64_t& copy = next_copy.emplace(base, 2).first->second;
    do {
      frame.name = base + "_" + std::to_string(copy++);
    } while (!names.insert(frame.name).second);
  }
  return std::move(scene_);
}

bool same_aspect(double scale_x, double scale_y) { return std::abs(scale_x / scale_y - 1) < 0.02; }

FittedImage fit_image(const std::filesystem::path& file, int64_t camera_width, int64_t camera_height) {
  const ImageFileInfo info = probe_image_file(file);
  FittedImage fitted;
  fitted.width = info.width;
  fitted.height = info.height;
  if (camera_width == 0 && camera_height == 0) return fitted;
  if (camera_width < 2 || camera_height < 2) {
    fail({file.string(), "a camera at least 2 pixels wide and high",
          std::to_string(camera_width) + "x" + std::to_string(camera_height), "check the camera's size"});
  }
  fitted.scale_x = static_cast<double>(info.width) / static_cast<double>(camera_width);
  fitted.scale_y = static_cast<double>(info.height) / static_cast<double>(camera_height);
  if (same_aspect(fitted.scale_x, fitted.scale_y)) return fitted;
  if (info.turned()) {
    std::swap(fitted.width, fitted.height);
    fitted.scale_x = static_cast<double>(fitted.width) / static_cast<double>(camera_width);
    fitted.scale_y = static_cast<double>(fitted.height) / static_cast<double>(camera_height);
    fitted.orientation = ImageOrientation::kUpright;
    if (same_aspect(fitted.scale_x, fitted.scale_y)) return fitted;
  }
  fail({file.string(),
        "an image of the camera's size " + std::to_string(camera_width) + "x" +
            std::to_string(camera_height) + " or a scaled copy",
        std::to_string(info.width) + "x" + std::to_string(info.height),
        "check that the camera belongs to this image and was not made for a rotated or cropped one"});
}

Eigen::Matrix3d scaled_intrinsics(const Eigen::Matrix3d& intrinsics, const FittedImage& fitted) {
  Eigen::Matrix3d k = intrinsics;
  k.row(0) *= fitted.scale_x;
  k.row(1) *= fitted.scale_y;
  return k;
}

}  // namespace gld
