#include "datasets/formats/re10k_reader.h"

#include "datasets/formats/file_listing.h"
#include "datasets/formats/frame_pixels.h"
#include "datasets/formats/text_fields.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/error.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <optional>
#include <utility>

namespace gld {
namespace {

constexpr size_t kFields = 19;

bool is_camera_file(const std::filesystem::path& file) {
  std::error_code error;
  if (file.extension() != ".txt" || !is_file(file)) return false;
  std::ifstream stream(file);
  char start[4] = {};
  stream.read(start, 4);
  return stream.gcount() == 4 && std::string(start, 4) == "http";
}

std::filesystem::path clip_text_file(const std::filesystem::path& path) {
  if (is_camera_file(path)) return path;
  std::vector<std::filesystem::path> found;
  for (const auto& file : list_files(path, ".txt")) {
    if (is_camera_file(file)) found.push_back(file);
  }
  return found.size() == 1 ? found.front() : std::filesystem::path();
}

std::vector<std::filesystem::path> clip_images(const std::filesystem::path& file,
                                               const std::string& asked_for) {
  const std::string clip = file.stem().string();
  const auto folder = file.parent_path();
  std::vector<std::filesystem::path> candidates;
  if (!asked_for.empty()) {
    candidates = {folder / asked_for / clip, folder / asked_for};
  } else {
    for (const auto& base : {folder, folder.parent_path()}) {
      for (const auto& candidate : {base / clip, base / "frames" / clip, base / "images" / clip}) {
        candidates.push_back(candidate);
      }
    }
    if (list_files(folder, ".txt").size() == 1) {
      for (const auto& candidate : {folder, folder / "frames", folder / "images"})
        candidates.push_back(candidate);
    }
  }
  for (const auto& candidate : candidates) {
    auto images = list_images(candidate);
    if (!images.empty()) return images;
  }
  fail({file.string(), "the clip's frames in " + clip + "/, frames/" + clip + "/ or images/" + clip + "/",
        "none", "extract them from the video, named by their times in microseconds"});
}

// Returns the image of every row, empty where there is none.
std::vector<std::filesystem::path> images_of_rows(const std::vector<Re10kRow>& rows,
                                                  const std::vector<std::filesystem::path>& images) {
  std::map<std::string, std::filesystem::path> by_stem;
  for (const auto& image : images) by_stem[image.stem().string()] = image;
  std::vector<std::filesystem::path> matched;
  bool any = false;
  for (const Re10kRow& row : rows) {
    auto found = by_stem.find(std::to_string(row.time));
    if (found == by_stem.end()) found = by_stem.find(std::to_string(row.time / 1000));
    any = any || found != by_stem.end();
    matched.push_back(found == by_stem.end() ? std::filesystem::path() : found->second);
  }
  if (!any && images.size() == rows.size()) return images;
  return matched;
}

}  // namespace

std::vector<Re10kRow> read_re10k_rows(const std::filesystem::path& file) {
  std::vector<Re10kRow> rows;
  bool first = true;  // the clip's address
  for (const TextLine& line : read_lines(file)) {
    const auto fields = blank_separated(line.text);
    if (std::exchange(first, false) || fields.empty()) continue;
    if (fields.size() != kFields) {
      fail({line.where, std::to_string(kFields) + " fields", std::to_string(fields.size()),
            "correct the file"});
    }
    Re10kRow row;
    row.where = line.where;
    row.time = parse_integer(fields[0], row.where);
    const auto n = parse_numbers(fields, 1, kFields - 1, row.where);
    row.relative_intrinsics = {n[0], n[1], n[2], n[3]};
    for (size_t k = 0; k < 12; ++k) {
      row.camera_from_world(static_cast<Eigen::Index>(k / 4), static_cast<Eigen::Index>(k % 4)) = n[6 + k];
    }
    rows.push_back(row);
  }
  return rows;
}

bool Re10kReader::recognises(const std::filesystem::path& path) const {
  return !clip_text_file(path).empty();
}

Scene Re10kReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  const auto file = clip_text_file(path);
  if (file.empty()) fail({path.string(), marker(), "none", "check the folder or choose another format"});
  const auto rows = read_re10k_rows(file);
  const auto images = images_of_rows(rows, clip_images(file, reading.image_folder));
  SceneBuilder builder(name(), file, reading);
  FrameMaker maker;
  for (size_t i = 0; i < rows.size(); ++i) {
    const Re10kRow& row = rows[i];
    if (images[i].empty()) {
      builder.add_missing(file.stem() / (std::to_string(row.time) + ".png"));
      continue;
    }
    builder.add(row.where, [&]() -> std::optional<Frame> {
      const FittedImage stored = fit_image(images[i], 0, 0);
      const auto width = static_cast<double>(stored.width);
      const auto height = static_cast<double>(stored.height);
      FrameRecord record;
      record.name = images[i].stem().string();
      record.image_file = images[i];
      const Eigen::Vector4d& k = row.relative_intrinsics;
      record.intrinsics = intrinsic_matrix(k[0] * width, k[1] * height, k[2] * width, k[3] * height);
      record.world_from_camera = checked_pose(row.camera_from_world, row.where).inverse();
      return maker.make(record);
    });
  }
  return builder.finish();
}

}  // namespace gld
