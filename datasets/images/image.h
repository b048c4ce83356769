#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// An 8-bit sRGB image, row by row, (height, width, 3).
struct Image {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<uint8_t> rgb;

  Image() = default;
  Image(int64_t image_width, int64_t image_height)
      : width(image_width), height(image_height), rgb(static_cast<size_t>(image_width * image_height * 3)) {}
  bool empty() const { return rgb.empty(); }
  uint8_t* pixel(int64_t x, int64_t y) { return rgb.data() + 3 * (y * width + x); }
  const uint8_t* pixel(int64_t x, int64_t y) const { return rgb.data() + 3 * (y * width + x); }
};

// Planar depth (the z of the point in the camera), row by row, (height, width). Metres where the scene is metric,
// otherwise in the unit of its poses. 0 means "not known"; every other value is positive and finite.
struct DepthMap {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> metres;

  DepthMap() = default;
  DepthMap(int64_t map_width, int64_t map_height)
      : width(map_width), height(map_height), metres(static_cast<size_t>(map_width * map_height)) {}
  bool empty() const { return metres.empty(); }
  float& at(int64_t x, int64_t y) { return metres[static_cast<size_t>(y * width + x)]; }
  float at(int64_t x, int64_t y) const { return metres[static_cast<size_t>(y * width + x)]; }
};

// Returns whether a value of a depth map says something: it is positive and finite.
inline bool is_known_depth(float depth) { return depth > 0 && std::isfinite(depth); }

// Which pixels of an image show the scene: 1 valid, 0 not (borders left by undistortion, masked people).
struct ValidityMask {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<uint8_t> valid;

  ValidityMask() = default;
  ValidityMask(int64_t mask_width, int64_t mask_height)
      : width(mask_width), height(mask_height), valid(static_cast<size_t>(mask_width * mask_height), 1) {}
  bool empty() const { return valid.empty(); }
};

// Returns text such as "504x280".
inline std::string size_text(int64_t width, int64_t height) {
  return std::to_string(width) + "x" + std::to_string(height);
}

}  // namespace gld
