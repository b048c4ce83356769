#include "datasets/formats/scannet_reader.h"

#include "datasets/formats/file_listing.h"
#include "datasets/formats/frame_pixels.h"
#include "datasets/formats/text_fields.h"
#include "datasets/images/image_file.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/error.h"
#include "gld/files/npy.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <regex>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

constexpr double kMetresPerUnit = 0.001;
constexpr uint64_t kMostListedPairs = 10'000'000;

Eigen::Matrix4d matrix_of_file(const std::filesystem::path& file) {
  constexpr size_t kMostFields = 64;  // of a file that is no matrix; enough to see that it is none
  std::vector<double> values;
  for (const TextLine& line : read_lines(file)) {
    for (const auto& field : blank_separated(line.text, kMostFields)) {
      values.push_back(parse_number(field, line.where));
    }
    if (values.size() > kMostFields) break;
  }
  if (values.size() != 16) {
    fail({file.string(), "a matrix of 4 rows of 4 numbers", fmt::format("{} numbers", values.size()),
          "export the scan again"});
  }
  return Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(values.data());
}

// The intrinsics of a scan's pictures and the size that they belong to.
struct ScanCamera {
  Eigen::Matrix3d intrinsics = Eigen::Matrix3d::Identity();
  int64_t width = 0;
  int64_t height = 0;
};

// ScanNet's colour camera has 1296x968 pixels; exports reduced to 640x480 have intrinsics of that size, which the
// principal point tells, for it lies near the middle.
ScanCamera camera_with(const Eigen::Matrix3d& intrinsics, const std::string& where) {
  constexpr double kNearTheMiddle = 0.15;
  for (const auto& [width, height] : {std::pair<int64_t, int64_t>{1296, 968}, {640, 480}}) {
    const auto middle = static_cast<double>(width) / 2;
    if (std::abs(intrinsics(0, 2) - middle) <= kNearTheMiddle * middle) return {intrinsics, width, height};
  }
  fail({where, "a principal point near the middle of 1296x968 or 640x480 pixels",
        fmt::format("one at column {:.0f}", intrinsics(0, 2)),
        "export the scan again in one of these sizes"});
}

ScanCamera camera_of_scan(const std::filesystem::path& scan) {
  const auto file = scan / "intrinsic" / "intrinsic_color.txt";
  if (is_file(file)) {
    return camera_with(matrix_of_file(file).topLeftCorner<3, 3>(), file.string());
  }
  const auto all = scan / ".." / "intrinsics.npz";
  if (!is_file(all)) {
    fail({scan.string(), "intrinsic/intrinsic_color.txt, or intrinsics.npz beside the scan", "neither",
          "export the scan again"});
  }
  const NpyArray array = NpzFile::open(all).read(folder_name(scan), 16 * sizeof(double));
  if (array.shape != std::vector<int64_t>{3, 3} && array.shape != std::vector<int64_t>{4, 4}) {
    fail({all.string(), folder_name(scan) + " of shape (3, 3) or (4, 4)",
          fmt::format("({})", fmt::join(array.shape, ", ")), "copy the file again"});
  }
  const auto values = array.to_doubles();
  ScanCamera camera{Eigen::Matrix3d::Identity(), 640, 480};
  for (Eigen::Index row = 0; row < 3; ++row) {
    for (Eigen::Index column = 0; column < 3; ++column) {
      camera.intrinsics(row, column) = values[static_cast<size_t>(row * array.shape[1] + column)];
    }
  }
  return camera;
}

// Adds the frames of a scan, in their order, and says how many have no pose.
void add_frames(SceneBuilder& builder, const std::filesystem::path& scan,
                const std::vector<std::string>& frames) {
  const ScanCamera camera = camera_of_scan(scan);
  FrameMaker maker;
  int64_t lost = 0;
  for (const std::string& number : frames) {
    const auto image = find_image(scan / "color", number);
    const auto pose_file = scan / "pose" / (number + ".txt");
    if (image.empty() || !is_file(pose_file)) {
      builder.add_missing(image.empty() ? scan / "color" / (number + ".jpg") : pose_file);
      continue;
    }
    builder.add(pose_file.string(), [&]() -> std::optional<Frame> {
      const Eigen::Matrix4d pose = matrix_of_file(pose_file);
      if (!pose.allFinite()) {
        ++lost;
        return std::nullopt;
      }
      FrameRecord record;
      record.name = number;
      record.image_file = image;
      record.intrinsics = camera.intrinsics;
      record.camera_width = camera.width;
      record.camera_height = camera.height;
      record.world_from_camera = checked_pose(pose, pose_file.string());
      const auto depth = scan / "depth" / (number + ".png");
      if (is_file(depth)) {
        record.load_depth = [depth] { return read_depth_png(depth, kMetresPerUnit); };
      }
      return maker.make(record);
    });
  }
  builder.warn(maker.crop_note());
  if (lost > 0 && builder.scene().frames.empty()) {
    fail({scan.string(), "frames with a pose",
          fmt::format("{} without one, where ScanNet's tracking was lost", lost), "leave the scan out"});
  }
  if (lost > 0) {
    builder.warn(
        fmt::format("{} of {} frames have no pose, where ScanNet's tracking was lost, and are left out.",
                    lost, frames.size()));
  }
  builder.scene().metric = true;
}

// Two frames of a scan.
struct FramePair {
  std::string scan;  // "scene0707_00"
  std::array<int64_t, 2> frames{};

  std::string part() const { return fmt::format("{}_{}_{}", scan, frames[0], frames[1]); }
};

std::vector<FramePair> pairs_of_array(const std::filesystem::path& file) {
  const NpyArray array = NpzFile::open(file).read("name", kMostListedPairs * 4 * sizeof(int64_t));
  if (array.shape.size() != 2 || array.shape[1] != 4) {
    fail({file.string(), "name of shape (pairs, 4)", fmt::format("({})", fmt::join(array.shape, ", ")),
          "copy the file again"});
  }
  const auto values = array.to_doubles();
  std::vector<FramePair> pairs;
  for (size_t row = 0; row + 4 <= values.size(); row += 4) {
    for (size_t column = 0; column < 4; ++column) {
      const double value = values[row + column];
      if (!(value >= 0 && value < 1e9 && value == std::floor(value))) {
        fail({fmt::format("{} row {}", file.string(), row / 4), "whole numbers from 0",
              fmt::format("{}", value), "copy the file again"});
      }
    }
    pairs.push_back({fmt::format("scene{:04d}_{:02d}", static_cast<int64_t>(values[row]),
                                 static_cast<int64_t>(values[row + 1])),
                     {static_cast<int64_t>(values[row + 2]), static_cast<int64_t>(values[row + 3])}});
  }
  return pairs;
}

std::vector<FramePair> pairs_of_text(const std::filesystem::path& file) {
  static const std::regex kPicture(R"((scene\d{4}_\d{2})_frame-(\d{1,9})\.jpg)");
  std::vector<FramePair> pairs;
  for (const TextLine& line : read_lines(file)) {
    const auto fields = blank_separated(line.text, 2);
    if (fields.empty()) continue;
    FramePair pair;
    std::array<std::string, 2> scans;
    for (size_t i = 0; i < 2; ++i) {
      std::smatch match;
      if (i >= fields.size() || fields[i].size() > 64 || !std::regex_match(fields[i], match, kPicture)) {
        fail({line.where, "the names of two pictures, such as scene0707_00_frame-000015.jpg",
              i >= fields.size() ? "fewer words" : "\"" + fields[i].substr(0, 64) + "\"",
              "copy the list again"});
      }
      scans[i] = match[1];
      pair.frames[i] = parse_integer(match[2], line.where);
    }
    if (scans[0] != scans[1]) {
      fail({line.where, "two pictures of one scan", scans[0] + " and " + scans[1], "copy the list again"});
    }
    pair.scan = scans[0];
    pairs.push_back(pair);
  }
  return pairs;
}

// Returns the list in that folder, or nothing.
std::filesystem::path pair_list(const std::filesystem::path& path) {
  for (const char* name : {"test.npz", "scannet_test_pairs_with_gt.txt"}) {
    if (is_file(path / name)) return path / name;
  }
  return {};
}

std::vector<FramePair> listed_pairs(const std::filesystem::path& path) {
  const auto list = pair_list(path);
  if (list.empty()) {
    fail({path.string(), "test.npz or scannet_test_pairs_with_gt.txt", "neither",
          "put the list beside the scans"});
  }
  auto pairs = list.extension() == ".npz" ? pairs_of_array(list) : pairs_of_text(list);
  if (pairs.empty()) fail({list.string(), "pairs of frames", "none", "copy the list again"});
  return pairs;
}

bool has_scans(const std::filesystem::path& path) {
  const auto folders = list_folders(path);
  return std::any_of(folders.begin(), folders.end(), [](const std::filesystem::path& folder) {
    return folder.filename().string().rfind("scene", 0) == 0 && ScannetReader().recognises(folder);
  });
}

}  // namespace

bool ScannetReader::recognises(const std::filesystem::path& path) const {
  return is_folder(path / "color") && !list_files(path / "pose", ".txt").empty();
}

Scene ScannetReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  SceneBuilder builder(name(), path, reading);
  std::vector<std::string> frames;
  for (const auto& file : list_files(path / "pose", ".txt")) frames.push_back(file.stem().string());
  add_frames(builder, path, frames);
  return builder.finish();
}

bool ScannetPairsReader::recognises(const std::filesystem::path& path) const {
  return !pair_list(path).empty() && has_scans(path);
}

std::vector<std::string> ScannetPairsReader::parts(const std::filesystem::path& path) const {
  std::vector<std::string> names;
  for (const FramePair& pair : listed_pairs(path)) names.push_back(pair.part());
  return names;
}

Scene ScannetPairsReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  const auto pairs = listed_pairs(path);
  const auto pair = std::find_if(pairs.begin(), pairs.end(),
                                 [&](const FramePair& known) { return known.part() == reading.part; });
  if (pair == pairs.end()) {
    fail({path.string(), fmt::format("one of its {} pairs, such as {}", pairs.size(), pairs.front().part()),
          reading.part.empty() ? "no choice" : reading.part, "choose one with --part"});
  }
  SceneBuilder builder(name(), path, reading);
  builder.scene().name = reading.part;
  add_frames(builder, path / pair->scan, {std::to_string(pair->frames[0]), std::to_string(pair->frames[1])});
  Scene scene = builder.finish();
  if (scene.frames.size() != pair->frames.size()) {
    fail({path.string() + " pair " + reading.part, "both of its frames", "one",
          "leave the pair out of the list"});
  }
  return scene;
}

}  // namespace gld
