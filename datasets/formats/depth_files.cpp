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

DepthMap read_depth_raw(const std::filesystem::path& file, int64_t width, int64_t height) {
  // The size is what a text file says: no memory for it before the file has that many bytes.
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
