#include "datasets/pictures/drawing.h"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

// OpenCV's stroke fonts look ragged at small sizes; text is drawn this many times larger and averaged down.
constexpr int kOversampling = 4;
constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;

// A capital letter of the font is 21 units high at scale 1.
double font_scale(const TextStyle& style) {
  return kOversampling * static_cast<double>(style.size) / 1.4 / 21;
}

int stroke(const TextStyle& style) {
  const double relative = style.weight == TextWeight::kBold ? 0.13 : 0.085;
  return std::max(1,
                  static_cast<int>(std::lround(relative * kOversampling * static_cast<double>(style.size))));
}

// One byte a character, as the font wants it; the continuation bytes of UTF-8 are dropped.
std::string printable(const std::string& text) {
  std::string result;
  for (const char c : text) {
    const auto byte = static_cast<uint8_t>(c);
    if ((byte & 0xc0) == 0x80) continue;
    result += byte >= 32 && byte < 127 ? c : '?';
  }
  return result;
}

cv::Mat view_of(const Image& image) {
  return cv::Mat(static_cast<int>(image.height), static_cast<int>(image.width), CV_8UC3,
                 const_cast<uint8_t*>(image.rgb.data()));
}

PixelRect clipped(const Image& image, const PixelRect& rect) {
  PixelRect result;
  result.x = std::clamp<int64_t>(rect.x, 0, image.width);
  result.y = std::clamp<int64_t>(rect.y, 0, image.height);
  result.width = std::clamp<int64_t>(rect.x + rect.width, result.x, image.width) - result.x;
  result.height = std::clamp<int64_t>(rect.y + rect.height, result.y, image.height) - result.y;
  return result;
}

}  // namespace

Image filled_image(int64_t width, int64_t height, const Rgb& colour) {
  Image image(width, height);
  fill_rect(image, {0, 0, width, height}, colour);
  return image;
}

void fill_rect(Image& image, const PixelRect& rect, const Rgb& colour) {
  const PixelRect inside = clipped(image, rect);
  for (int64_t y = inside.y; y < inside.y + inside.height; ++y) {
    for (int64_t x = inside.x; x < inside.x + inside.width; ++x) {
      std::copy(colour.begin(), colour.end(), image.pixel(x, y));
    }
  }
}

void paste(Image& image, const Image& picture, int64_t x, int64_t y) {
  const PixelRect inside = clipped(image, {x, y, picture.width, picture.height});
  for (int64_t row = 0; row < inside.height; ++row) {
    const uint8_t* from = picture.pixel(inside.x - x, inside.y - y + row);
    std::copy(from, from + 3 * inside.width, image.pixel(inside.x, inside.y + row));
  }
}

Image resized(const Image& picture, int64_t width, int64_t height) {
  if (picture.width == width && picture.height == height) return picture;
  Image result(width, height);
  cv::Mat target = view_of(result);
  const bool smaller = width < picture.width || height < picture.height;
  cv::resize(view_of(picture), target, target.size(), 0, 0, smaller ? cv::INTER_AREA : cv::INTER_CUBIC);
  return result;
}

int64_t text_width(const std::string& text, const TextStyle& style) {
  int baseline = 0;
  const cv::Size size = cv::getTextSize(printable(text), kFont, font_scale(style), stroke(style), &baseline);
  return (size.width + kOversampling - 1) / kOversampling;
}

void draw_text(Image& image, int64_t x, int64_t y, const std::string& text, const TextStyle& style) {
  if (text.empty()) return;
  const int margin = 2;  // pixels around the text that a stroke may reach into
  const int width = static_cast<int>(text_width(text, style)) + 2 * margin;
  const int height = static_cast<int>(style.size) * 2;
  cv::Mat large = cv::Mat::zeros(height * kOversampling, width * kOversampling, CV_8UC1);
  cv::putText(large, printable(text),
              cv::Point(margin * kOversampling, static_cast<int>(style.size) * kOversampling), kFont,
              font_scale(style), cv::Scalar(255), stroke(style), cv::LINE_AA);
  cv::Mat cover;
  cv::resize(large, cover, cv::Size(width, height), 0, 0, cv::INTER_AREA);
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      const int64_t to_x = x + column - margin;
      const int64_t to_y = y + row;
      if (to_x < 0 || to_y < 0 || to_x >= image.width || to_y >= image.height) continue;
      const int alpha = cover.at<uint8_t>(row, column);
      uint8_t* pixel = image.pixel(to_x, to_y);
      for (size_t channel = 0; channel < 3; ++channel) {
        pixel[channel] = static_cast<uint8_t>(
            (pixel[channel] * (255 - alpha) + style.colour[channel] * alpha + 127) / 255);
      }
    }
  }
}

std::string fitted_text(const std::string& text, int64_t width, const TextStyle& style) {
  if (text_width(text, style) <= width) return text;
  std::string beginning = printable(text);
  while (!beginning.empty() && text_width(beginning + "..", style) > width) beginning.pop_back();
  return beginning.empty() ? beginning : beginning + "..";
}

}  // namespace gld
