#include "datasets/scenes/undistortion.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <utility>

#include <Eigen/LU>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

void check_size(int64_t width, int64_t height, const Undistorter::Size& expected) {
  if (width == expected.width && height == expected.height) return;
  fail({"undistortion",
        "a picture of " + std::to_string(expected.width) + "x" + std::to_string(expected.height),
        std::to_string(width) + "x" + std::to_string(height), "check that camera and files belong together"});
}

// Returns whether a position lies within the picture; the first pixel's centre is (0, 0).
bool has_pixel(const Undistorter::Size& size, double x, double y) {
  return std::lround(x) >= 0 && std::lround(y) >= 0 && std::lround(x) < size.width &&
         std::lround(y) < size.height;
}

// Maps ideal pixels to source pixels, (0.5, 0.5) the first centre.
Undistorter::PixelMapping lens_mapping(const Camera& ideal, const LensCamera& source) {
  const Eigen::Matrix3d ray_from_pixel = ideal.intrinsics.inverse();
  const double limit = largest_ideal_radius(source.lens);
  return [ray_from_pixel, source, limit](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
    const Eigen::Vector2d point = (ray_from_pixel * pixel.homogeneous()).hnormalized();
    if (point.norm() > limit) return {-1e9, -1e9};
    return (source.intrinsics * distorted(source.lens, point).homogeneous()).hnormalized();
  };
}

// A rectangle of pixels: columns left to right and rows top to bottom, both inclusive.
struct PixelBounds {
  int64_t left = 0, top = 0, right = 0, bottom = 0;
};

constexpr int64_t kCropCells = 64;     // in each direction, to begin with
constexpr int64_t kLineSamples = 128;  // of a line

// Returns the largest rectangle of cells whose four corners are all inside; corners has (kCropCells + 1)^2 entries, row
// by row. It is empty (right < left) where there is none. It is in cells, ends exclusive as corners.
PixelBounds largest_rectangle(const std::vector<uint8_t>& corners) {
  constexpr int64_t kCorners = kCropCells + 1;
  const auto inside = [&](int64_t x, int64_t y) {
    return corners[static_cast<size_t>(y * kCorners + x)] != 0;
  };
  std::vector<int64_t> height(kCropCells, 0);  // of the column of good cells that ends in this row
  PixelBounds best{0, 0, -1, -1};
  int64_t best_area = 0;
  for (int64_t y = 0; y < kCropCells; ++y) {
    for (int64_t x = 0; x < kCropCells; ++x) {
      const bool good = inside(x, y) && inside(x + 1, y) && inside(x, y + 1) && inside(x + 1, y + 1);
      auto& column = height[static_cast<size_t>(x)];
      column = good ? column + 1 : 0;
    }
    for (int64_t left = 0; left < kCropCells; ++left) {
      int64_t lowest = kCropCells;
      for (int64_t right = left; right < kCropCells; ++right) {
        lowest = std::min(lowest, height[static_cast<size_t>(right)]);
        const int64_t area = lowest * (right - left + 1);
        if (area <= best_area) continue;
        best_area = area;
        best = {left, y + 1 - lowest, right + 1, y + 1};
      }
    }
  }
  return best;
}

}  // namespace

Undistorter::Undistorter(const Size& ideal, const Size& source, PixelMapping mapping)
    : ideal_(ideal), source_(source), mapping_(std::move(mapping)) {}

const Undistorter::Table& Undistorter::table() const {
  std::call_once(made_, [this] {
    const auto count = static_cast<size_t>(ideal_.width * ideal_.height);
    table_.x.resize(count);
    table_.y.resize(count);
    size_t i = 0;
    for (int64_t y = 0; y < ideal_.height; ++y) {
      for (int64_t x = 0; x < ideal_.width; ++x, ++i) {
        const Eigen::Vector2d p = mapping_({static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5}) -
                                  Eigen::Vector2d(0.5, 0.5);
        const bool usable = p.allFinite() && p.cwiseAbs().maxCoeff() < 1e6;
        table_.x[i] = usable ? static_cast<float>(p.x()) : -10.0F;
        table_.y[i] = usable ? static_cast<float>(p.y()) : -10.0F;
      }
    }
  });
  return table_;
}

Image Undistorter::image(const Image& source) const {
  check_size(source.width, source.height, source_);
  const Table& map = table();
  const int rows = static_cast<int>(ideal_.height);
  const int columns = static_cast<int>(ideal_.width);
  const cv::Mat map_x(rows, columns, CV_32FC1, const_cast<float*>(map.x.data()));
  const cv::Mat map_y(rows, columns, CV_32FC1, const_cast<float*>(map.y.data()));
  const cv::Mat from(static_cast<int>(source.height), static_cast<int>(source.width), CV_8UC3,
                     const_cast<uint8_t*>(source.rgb.data()));
  Image result(ideal_.width, ideal_.height);
  cv::Mat to(rows, columns, CV_8UC3, result.rgb.data());
  // A position within a pixel of the source takes its colour, half of it lies beyond the outermost centres.
  cv::remap(from, to, map_x, map_y, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  for (size_t i = 0; i < map.x.size(); ++i) {
    if (has_pixel(source_, map.x[i], map.y[i])) continue;
    for (size_t c = 0; c < 3; ++c) result.rgb[3 * i + c] = 0;
  }
  return result;
}

DepthMap Undistorter::depth(const DepthMap& source) const {
  check_size(source.width, source.height, source_);
  const Table& map = table();
  DepthMap result(ideal_.width, ideal_.height);
  for (size_t i = 0; i < result.metres.size(); ++i) {
    const auto x = static_cast<int64_t>(std::lround(map.x[i]));
    const auto y = static_cast<int64_t>(std::lround(map.y[i]));
    if (x >= 0 && y >= 0 && x < source.width && y < source.height) result.metres[i] = source.at(x, y);
  }
  return result;
}

ValidityMask Undistorter::validity() const { return validity(ValidityMask(source_.width, source_.height)); }

ValidityMask Undistorter::validity(const ValidityMask& source) const {
  check_size(source.width, source.height, source_);
  const Table& map = table();
  ValidityMask result(ideal_.width, ideal_.height);
  for (size_t i = 0; i < result.valid.size(); ++i) {
    const auto x = static_cast<int64_t>(std::lround(map.x[i]));
    const auto y = static_cast<int64_t>(std::lround(map.y[i]));
    result.valid[i] =
        has_pixel(source_, map.x[i], map.y[i]) ? source.valid[static_cast<size_t>(y * source.width + x)] : 0;
  }
  return result;
}

std::shared_ptr<const Undistorter> make_undistorter(const Camera& ideal, const LensCamera& source) {
  return std::make_shared<const Undistorter>(Undistorter::Size{ideal.width, ideal.height},
                                             Undistorter::Size{source.width, source.height},
                                             lens_mapping(ideal, source));
}

Camera cropped_to_source(const Camera& ideal, const LensCamera& source) {
  const auto mapping = lens_mapping(ideal, source);
  const Undistorter::Size size{source.width, source.height};
  const auto inside = [&](int64_t x, int64_t y) {
    const Eigen::Vector2d p = mapping({static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5});
    return p.allFinite() && p.cwiseAbs().maxCoeff() < 1e6 && has_pixel(size, p.x() - 0.5, p.y() - 0.5);
  };
  const auto column = [&](int64_t corner) { return corner * (ideal.width - 1) / kCropCells; };
  const auto row = [&](int64_t corner) { return corner * (ideal.height - 1) / kCropCells; };
  std::vector<uint8_t> corners;
  for (int64_t y = 0; y <= kCropCells; ++y) {
    for (int64_t x = 0; x <= kCropCells; ++x) corners.push_back(inside(column(x), row(y)) ? 1 : 0);
  }
  const PixelBounds cells = largest_rectangle(corners);
  PixelBounds kept{column(cells.left), row(cells.top), column(cells.right), row(cells.bottom)};
  if (cells.right < cells.left || kept.right <= kept.left || kept.bottom <= kept.top) {
    fail({"undistortion", "a lens whose picture holds part of the ideal one", "none of it",
          "check the lens distortion"});
  }
  const auto line_inside = [&](const PixelBounds& line) {
    for (int64_t i = 0; i <= kLineSamples; ++i) {
      if (!inside(line.left + i * (line.right - line.left) / kLineSamples,
                  line.top + i * (line.bottom - line.top) / kLineSamples)) {
        return false;
      }
    }
    return true;
  };
  // Each side moves out as far as its line stays inside, by bisection within a cell; then the corners lie on lines
  // tested.
  const auto moved = [&](int64_t from, int64_t to, const auto& line_at) {
    if (line_inside(line_at(to))) return to;
    while (std::abs(to - from) > 1) {
      const int64_t middle = (from + to) / 2;
      (line_inside(line_at(middle)) ? from : to) = middle;
    }
    return from;
  };
  const auto vertical = [&](int64_t x) { return PixelBounds{x, kept.top, x, kept.bottom}; };
  const auto horizontal = [&](int64_t y) { return PixelBounds{kept.left, y, kept.right, y}; };
  kept.left = moved(kept.left, column(std::max<int64_t>(0, cells.left - 1)), vertical);
  kept.right = moved(kept.right, column(std::min(kCropCells, cells.right + 1)), vertical);
  kept.top = moved(kept.top, row(std::max<int64_t>(0, cells.top - 1)), horizontal);
  kept.bottom = moved(kept.bottom, row(std::min(kCropCells, cells.bottom + 1)), horizontal);
  Camera cropped = ideal;
  cropped.width = kept.right - kept.left + 1;
  cropped.height = kept.bottom - kept.top + 1;
  cropped.intrinsics(0, 2) -= static_cast<double>(kept.left);
  cropped.intrinsics(1, 2) -= static_cast<double>(kept.top);
  return cropped;
}

}  // namespace gld
