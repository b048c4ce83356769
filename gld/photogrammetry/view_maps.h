#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace gld {

// How sure the geometry head is of each pixel, row by row, (height, width). Published heads give values from 1 upwards.
struct ConfidenceMap {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> values;

  ConfidenceMap() = default;
  ConfidenceMap(int64_t map_width, int64_t map_height)
      : width(map_width), height(map_height), values(static_cast<size_t>(map_width * map_height)) {}
  bool empty() const { return values.empty(); }
  float& at(int64_t x, int64_t y) { return values[static_cast<size_t>(y * width + x)]; }
  float at(int64_t x, int64_t y) const { return values[static_cast<size_t>(y * width + x)]; }
};

// The rays of a view's pixels in the frame of the geometry head, row by row, (height, width, 6): direction (3), then
// origin (3). A direction need not have length 1: where it is rotation * intrinsics^-1 * (u, v, 1), origin + planar
// depth * direction is the point. The map may be coarser than the image; its cells cover the image evenly.
struct RayMap {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> values;

  RayMap() = default;
  RayMap(int64_t map_width, int64_t map_height)
      : width(map_width), height(map_height), values(static_cast<size_t>(map_width * map_height * 6)) {}
  bool empty() const { return values.empty(); }
  float* ray(int64_t x, int64_t y) { return values.data() + 6 * (y * width + x); }
  const float* ray(int64_t x, int64_t y) const { return values.data() + 6 * (y * width + x); }
};

// Where each pixel of a view lies, in the frame of the rays, row by row, (height, width, 3).
struct PointMap {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> values;

  PointMap() = default;
  PointMap(int64_t map_width, int64_t map_height)
      : width(map_width), height(map_height), values(static_cast<size_t>(map_width * map_height * 3)) {}
  bool empty() const { return values.empty(); }
  float* point(int64_t x, int64_t y) { return values.data() + 3 * (y * width + x); }
  const float* point(int64_t x, int64_t y) const { return values.data() + 3 * (y * width + x); }
};

}  // namespace gld
