#include "datasets/scenes/undistortion.h"

#include "gld/base/error.h"

#include <cmath>
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
  cv::remap(from, to, map_x, map_y, cv::INTER_LINEAR, cv::BORDER_CONSTANT);
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
    const bool inside = x >= 0 && y >= 0 && x < source.width && y < source.height;
    result.valid[i] = inside ? source.valid[static_cast<size_t>(y * source.width + x)] : 0;
  }
  return result;
}

std::shared_ptr<const Undistorter> make_undistorter(const Camera& ideal, const LensCamera& source) {
  const Eigen::Matrix3d ray_from_pixel = ideal.intrinsics.inverse();
  const double limit = largest_ideal_radius(source.lens);
  const auto mapping = [ray_from_pixel, source, limit](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
    const Eigen::Vector2d point = (ray_from_pixel * pixel.homogeneous()).hnormalized();
    if (point.norm() > limit) return {-1e9, -1e9};
    return (source.intrinsics * distorted(source.lens, point).homogeneous()).hnormalized();
  };
  return std::make_shared<const Undistorter>(Undistorter::Size{ideal.width, ideal.height},
                                             Undistorter::Size{source.width, source.height}, mapping);
}

}  // namespace gld
