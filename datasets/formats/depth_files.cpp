#include "datasets/formats/depth_files.h"

#include "datasets/images/decoded_pixels.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/files/npy.h"

#include <cmath>
#include <cstring>

namespace gld {

void clear_unknown(DepthMap& depth) {
  for (float& value : depth.metres) {
    if (!std::isfinite(value) || value <= 0) value = 0;
  }
}

DepthMap read_depth_npy(const std::filesystem::path& file) {
  const NpyArray array = read_npy(file, kMostPixels * sizeof(double));
  const bool flat = array.shape.size() == 2 || (array.shape.size() == 3 && array.shape[2] == 1);
  if (!flat || !is_floating(array.dtype)) {
    std::string shape;
    for (int64_t extent : array.shape) shape += (shape.empty() ? "" : ", ") + std::to_string(extent);
    fail({file.string(), "depth as (height, width) of floating type",
          dtype_name(array.dtype) + " (" + shape + ")", "check the file"});
  }
  check_picture_size(array.shape[1], array.shape[0], file.string());
  DepthMap depth;
  depth.height = array.shape[0];
  depth.width = array.shape[1];
  depth.metres = array.to_floats();
  clear_unknown(depth);
  return depth;
}

void write_depth_npy(const std::filesystem::path& file, const DepthMap& depth) {
  write_npy(file, npy_from_floats({depth.height, depth.width}, depth.metres.data()));
}

std::vector<Eigen::Vector3d> read_points_npy(const std::filesystem::path& file) {
  constexpr uint64_t kMostBytes = uint64_t{1} << 30;
  const NpyArray array = read_npy(file, kMostBytes);
  if (array.shape.size() != 2 || array.shape[1] != 3 || !is_floating(array.dtype)) {
    fail({file.string(), "points as (points, 3) of floating type", "another array", "check the file"});
  }
  const std::vector<double> values = array.to_doubles();
  std::vector<Eigen::Vector3d> points;
  for (size_t i = 0; i + 2 < values.size(); i += 3) {
    points.emplace_back(values[i], values[i + 1], values[i + 2]);
    if (!points.back().allFinite()) {
      fail({file.string(), "finite points", "another one in row " + std::to_string(i / 3), "check the file"});
    }
  }
  return points;
}

void write_points_npy(const std::filesystem::path& file, const std::vector<Eigen::Vector3d>& points) {
  std::vector<double> values;
  for (const Eigen::Vector3d& point : points) values.insert(values.end(), {point.x(), point.y(), point.z()});
  write_npy(file, npy_from_doubles({static_cast<int64_t>(points.size()), 3}, values.data()));
}

DepthMap read_depth_raw(const std::filesystem::path& file, int64_t width, int64_t height) {
  // The size is what a text file says: it gets no memory before the file has that many bytes.
  check_picture_size(width, height, file.string());
  const std::string bytes = read_file(file, kMostPixels * sizeof(float));
  const auto expected = static_cast<size_t>(width * height) * sizeof(float);
  if (bytes.size() != expected) {
    fail({file.string(),
          std::to_string(width) + "x" + std::to_string(height) + " float32 values (" +
              std::to_string(expected) + " bytes)",
          std::to_string(bytes.size()) + " bytes", "check that depth and camera belong together"});
  }
  DepthMap depth(width, height);
  std::memcpy(depth.metres.data(), bytes.data(), expected);
  clear_unknown(depth);
  return depth;
}

void write_depth_raw(const std::filesystem::path& file, const DepthMap& depth) {
  DepthMap stored = depth;
  for (float& value : stored.metres) {
    if (value <= 0) value = INFINITY;
  }
  std::string bytes(stored.metres.size() * sizeof(float), '\0');
  std::memcpy(bytes.data(), stored.metres.data(), bytes.size());
  write_file_atomically(file, bytes);
}

}  // namespace gld
