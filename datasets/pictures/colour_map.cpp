#include "datasets/pictures/colour_map.h"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

std::array<Rgb, 256> make_table() {
  cv::Mat ramp(1, 256, CV_8UC1);
  for (int i = 0; i < 256; ++i) ramp.at<uint8_t>(0, i) = static_cast<uint8_t>(i);
  cv::Mat coloured;
  cv::applyColorMap(ramp, coloured, cv::COLORMAP_VIRIDIS);
  std::array<Rgb, 256> table{};
  for (int i = 0; i < 256; ++i) {
    const auto bgr = coloured.at<cv::Vec3b>(0, i);
    table[static_cast<size_t>(i)] = {bgr[2], bgr[1], bgr[0]};
  }
  return table;
}

}  // namespace

Rgb viridis(double position) {
  static const std::array<Rgb, 256> table = make_table();
  const double clamped = position > 0 ? std::min(position, 1.0) : 0.0;
  return table[static_cast<size_t>(std::lround(clamped * 255))];
}

}  // namespace gld
