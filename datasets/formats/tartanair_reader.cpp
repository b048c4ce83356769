#include "datasets/formats/tartanair_reader.h"

#include "datasets/formats/depth_files.h"
#include "datasets/formats/file_listing.h"
#include "datasets/formats/frame_pixels.h"
#include "datasets/formats/text_fields.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/error.h"

#include <optional>

namespace gld {
namespace {

// Returns the camera's OpenCV axes in its north-east-down ones: right is east, down is down, forward is north.
Eigen::Matrix3d ned_from_opencv() {
  Eigen::Matrix3d axes;
  axes << 0, 0, 1,  //
      1, 0, 0,      //
      0, 1, 0;
  return axes;
}

std::vector<TextLine> pose_rows(const std::filesystem::path& file) {
  std::vector<TextLine> rows;
  for (const TextLine& line : read_lines(file)) {
    if (!blank_separated(line.text).empty()) rows.push_back(line);
  }
  return rows;
}

Eigen::Isometry3d pose_of_row(const TextLine& row) {
  const auto fields = blank_separated(row.text);
  if (fields.size() != 7) {
    fail({row.where, "7 fields: tx ty tz qx qy qz qw", std::to_string(fields.size()), "correct the file"});
  }
  const auto n = parse_numbers(fields, 0, 7, row.where);
  QuaternionPose ned;
  ned.translation = {n[0], n[1], n[2]};
  ned.rotation = Eigen::Quaterniond(n[6], n[3], n[4], n[5]);
  Eigen::Isometry3d pose = checked_pose(ned, row.where);
  pose.linear() = pose.linear() * ned_from_opencv();
  return pose;
}

}  // namespace

bool TartanAirReader::recognises(const std::filesystem::path& path) const {
  return is_file(path / "pose_left.txt");
}

Scene TartanAirReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  const auto rows = pose_rows(path / "pose_left.txt");
  const auto images = list_images(path / "image_left");
  if (images.size() != rows.size()) {
    fail({(path / "pose_left.txt").string(),
          "one row for each of the " + std::to_string(images.size()) + " images",
          std::to_string(rows.size()) + " rows", "copy the scene again"});
  }
  SceneBuilder builder(name(), path, reading);
  FrameMaker maker;
  for (size_t i = 0; i < rows.size(); ++i) {
    builder.add(rows[i].where, [&]() -> std::optional<Frame> {
      FrameRecord record;
      record.name = images[i].stem().string();
      record.image_file = images[i];
      record.camera_width = 640;
      record.camera_height = 480;
      record.intrinsics = intrinsic_matrix(320, 320, 320, 240);
      record.world_from_camera = pose_of_row(rows[i]);
      const auto depth = path / "depth_left" / (record.name + "_depth.npy");
      if (is_file(depth)) {
        record.load_depth = [depth] { return read_depth_npy(depth); };
      }
      return maker.make(record);
    });
  }
  builder.scene().metric = true;
  return builder.finish();
}

}  // namespace gld
