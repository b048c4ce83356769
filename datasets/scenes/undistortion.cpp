#include "datasets/scenes/undistortion.h"

#include "gld/base/error.h"

#include <algorithm>
#include <array>
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

constexpr float kNowhere = -10;  // a position that is not in the source
// Positions are kept of every fourth pixel each way, and are between them as on a plane: off by a hundredth of a pixel
// at the ends of wide lenses, less than the thirty-seconds in which remap() counts.
constexpr int64_t kNodeStep = 4;

int64_t nodes_for(int64_t side) { return (side - 1) / kNodeStep + 2; }

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

void Undistorter::Positions::resize(int64_t count) {
  x.resize(static_cast<size_t>(count));
  y.resize(static_cast<size_t>(count));
}

Eigen::Vector2f Undistorter::position(int64_t x, int64_t y) const {
  const Eigen::Vector2d p =
      mapping_({static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5}) - Eigen::Vector2d(0.5, 0.5);
  const bool usable = p.allFinite() && p.cwiseAbs().maxCoeff() < 1e6;
  return usable ? Eigen::Vector2f(p.cast<float>()) : Eigen::Vector2f(kNowhere, kNowhere);
}

const Undistorter::Positions& Undistorter::nodes() const {
  std::call_once(made_, [this] {
    const int64_t columns = nodes_for(ideal_.width), rows = nodes_for(ideal_.height);
    nodes_.resize(columns * rows);
    for (int64_t row = 0; row < rows; ++row) {
      for (int64_t column = 0; column < columns; ++column) {
        const Eigen::Vector2f p = position(kNodeStep * column, kNodeStep * row);
        nodes_.x[static_cast<size_t>(row * columns + column)] = p.x();
        nodes_.y[static_cast<size_t>(row * columns + column)] = p.y();
      }
    }
  });
  return nodes_;
}

Undistorter::Positions Undistorter::positions(int64_t first_row, int64_t rows) const {
  const Positions& known = nodes();
  const auto columns = static_cast<size_t>(nodes_for(ideal_.width));
  Positions result;
  result.resize(rows * ideal_.width);
  size_t i = 0;
  for (int64_t y = first_row; y < first_row + rows; ++y) {
    const float down = static_cast<float>(y % kNodeStep) / kNodeStep;
    for (int64_t x = 0; x < ideal_.width; ++x, ++i) {
      const float right = static_cast<float>(x % kNodeStep) / kNodeStep;
      const size_t node = static_cast<size_t>(y / kNodeStep) * columns + static_cast<size_t>(x / kNodeStep);
      const std::array<size_t, 4> around{node, node + 1, node + columns, node + columns + 1};
      const bool all =
          std::all_of(around.begin(), around.end(), [&](size_t at) { return known.x[at] != kNowhere; });
      if (!all) {  // at the lens's end
        const Eigen::Vector2f p = position(x, y);
        result.x[i] = p.x();
        result.y[i] = p.y();
        continue;
      }
      const auto between = [&](const std::vector<float>& of) {
        const float above = of[around[0]] + right * (of[around[1]] - of[around[0]]);
        const float below = of[around[2]] + right * (of[around[3]] - of[around[2]]);
        return above + down * (below - above);
      };
      result.x[i] = between(known.x);
      result.y[i] = between(known.y);
    }
  }
  return result;
}

void Undistorter::for_rows(
    const std::function<void(int64_t row, const Positions& row_positions)>& done) const {
  for (int64_t row = 0; row < ideal_.height; ++row) done(row, positions(row, 1));
}

Image Undistorter::image(const Image& source) const {
  check_size(source.width, source.height, source_);
  constexpr int64_t kRowsAtOnce = 64;
  const int columns = static_cast<int>(ideal_.width);
  const cv::Mat from(static_cast<int>(source.height), static_cast<int>(source.width), CV_8UC3,
                     const_cast<uint8_t*>(source.rgb.data()));
  Image result(ideal_.width, ideal_.height);
  for (int64_t first = 0; first < ideal_.height; first += kRowsAtOnce) {
    const int64_t rows = std::min(kRowsAtOnce, ideal_.height - first);
    Positions map = positions(first, rows);
    const cv::Mat map_x(static_cast<int>(rows), columns, CV_32FC1, map.x.data());
    const cv::Mat map_y(static_cast<int>(rows), columns, CV_32FC1, map.y.data());
    uint8_t* pixels = result.rgb.data() + 3 * first * ideal_.width;
    cv::Mat to(static_cast<int>(rows), columns, CV_8UC3, pixels);
    // A position within a pixel of the source takes its colour, half of it lies beyond the outermost centres.
    cv::remap(from, to, map_x, map_y, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
    for (size_t i = 0; i < map.x.size(); ++i) {
      if (has_pixel(source_, map.x[i], map.y[i])) continue;
      for (size_t c = 0; c < 3; ++c) pixels[3 * i + c] = 0;
    }
  }
  return result;
}

DepthMap Undistorter::depth(const DepthMap& source) const {
  check_size(source.width, source.height, source_);
  DepthMap result(ideal_.width, ideal_.height);
  for_rows([&](int64_t row, const Positions& map) {
    for (int64_t column = 0; column < ideal_.width; ++column) {
      const auto x = static_cast<int64_t>(std::lround(map.x[static_cast<size_t>(column)]));
      const auto y = static_cast<int64_t>(std::lround(map.y[static_cast<size_t>(column)]));
      if (x >= 0 && y >= 0 && x < source.width && y < source.height)
        result.metres[static_cast<size_t>(row * ideal_.width + column)] = source.at(x, y);
    }
  });
  return result;
}

ValidityMask Undistorter::validity() const { return validity(ValidityMask(source_.width, source_.height)); }

ValidityMask Undistorter::validity(const ValidityMask& source) const {
  check_size(source.width, source.height, source_);
  ValidityMask result(ideal_.width, ideal_.height);
  for_rows([&](int64_t row, const Positions& map) {
    for (int64_t column = 0; column < ideal_.width; ++column) {
      const float x = map.x[static_cast<size_t>(column)], y = map.y[static_cast<size_t>(column)];
      result.valid[static_cast<size_t>(row * ideal_.width + column)] =
          has_pixel(source_, x, y)
              ? source.valid[static_cast<size_t>(std::lround(y) * source.width + std::lround(x))]
              : 0;
    }
  });
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
