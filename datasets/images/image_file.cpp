#include "datasets/images/image_file.h"

#include "datasets/images/decoded_pixels.h"
#include "datasets/images/heif_file.h"
#include "datasets/images/image_format.h"
#include "datasets/images/image_probe.h"
#include "datasets/images/jpeg_file.h"
#include "datasets/images/png_file.h"
#include "datasets/images/tiff_file.h"
#include "datasets/images/webp_file.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

constexpr uint64_t kLargestImageFile = uint64_t{1} << 30;

// The file is decoded from memory so that what was probed is what is decoded. OpenCV's decoders print what is wrong
// with a file and go on where they can; ours refuse it.
DecodedPixels decode(const std::string& bytes, const std::string& where) {
  switch (image_format(bytes).value_or(ImageFormat::kPng)) {
    case ImageFormat::kJpeg:
      return decode_jpeg(bytes, where);
    case ImageFormat::kWebp:
      return decode_webp(bytes, where);
    case ImageFormat::kTiff:
      return decode_tiff(bytes, where);
    case ImageFormat::kHeif:
      return decode_heif(bytes, where);
    case ImageFormat::kPng:
      break;
  }
  return decode_png(bytes, where);
}

// The matrix lies over the bytes of pixels, which must live as long.
cv::Mat matrix_of(DecodedPixels& pixels) {
  const int type = CV_MAKETYPE(pixels.bits == 16 ? CV_16U : CV_8U, pixels.channels);
  return {static_cast<int>(pixels.height), static_cast<int>(pixels.width), type, pixels.bytes.data()};
}

cv::Mat to_eight_bits(const cv::Mat& image, const std::string& where) {
  if (image.depth() == CV_8U) return image;
  if (image.depth() != CV_16U) {
    fail({where, "8 or 16 bits a channel", "another pixel type", "convert it"});
  }
  cv::Mat eight;
  image.convertTo(eight, CV_8U, 1.0 / 257.0);
  return eight;
}

cv::Mat over_white(const cv::Mat& bgra) {
  cv::Mat bgr(bgra.rows, bgra.cols, CV_8UC3);
  for (int y = 0; y < bgra.rows; ++y) {
    const auto* from = bgra.ptr<cv::Vec4b>(y);
    auto* to = bgr.ptr<cv::Vec3b>(y);
    for (int x = 0; x < bgra.cols; ++x) {
      const int alpha = from[x][3];
      for (int c = 0; c < 3; ++c) {
        to[x][c] = static_cast<uint8_t>((from[x][c] * alpha + 255 * (255 - alpha) + 127) / 255);
      }
    }
  }
  return bgr;
}

cv::Mat turned_upright(const cv::Mat& image, int orientation) {
  cv::Mat result = image;
  if (orientation >= 5) cv::transpose(result, result);
  // After the optional transposition, what remains is a mirror about one axis or both.
  switch (orientation) {
    case 2:
    case 6:
      cv::flip(result, result, 1);
      break;
    case 3:
    case 7:
      cv::flip(result, result, -1);
      break;
    case 4:
    case 8:
      cv::flip(result, result, 0);
      break;
    default:
      break;
  }
  return result;
}

}  // namespace

Image read_image(const std::filesystem::path& file, ImageOrientation orientation) {
  const std::string bytes = read_file(file, kLargestImageFile);
  const std::string where = file.string();
  const ImageFileInfo info = probe_image_bytes(bytes, where);
  DecodedPixels decoded = decode(bytes, where);
  cv::Mat pixels = to_eight_bits(matrix_of(decoded), where);
  cv::Mat rgb;
  switch (pixels.channels()) {
    case 1:
      cv::cvtColor(pixels, rgb, cv::COLOR_GRAY2RGB);
      break;
    case 3:
      cv::cvtColor(pixels, rgb, cv::COLOR_BGR2RGB);
      break;
    case 4:
      cv::cvtColor(over_white(pixels), rgb, cv::COLOR_BGR2RGB);
      break;
    default:
      fail({where, "1, 3 or 4 channels", std::to_string(pixels.channels()), "convert it"});
  }
  if (orientation == ImageOrientation::kUpright) rgb = turned_upright(rgb, info.orientation);
  if (!rgb.isContinuous()) rgb = rgb.clone();
  Image image(rgb.cols, rgb.rows);
  std::copy(rgb.datastart, rgb.dataend, image.rgb.begin());
  return image;
}

DepthMap read_depth_png(const std::filesystem::path& file, double metres_per_unit) {
  const std::string bytes = read_file(file, kLargestImageFile);
  const std::string where = file.string();
  probe_image_bytes(bytes, where);
  DecodedPixels decoded = decode(bytes, where);
  const cv::Mat pixels = matrix_of(decoded);
  if (pixels.type() != CV_16UC1) {
    fail({where, "a 16-bit image with one channel", "another pixel type", "write depth as 16-bit grey PNG"});
  }
  DepthMap depth(pixels.cols, pixels.rows);
  for (int y = 0; y < pixels.rows; ++y) {
    const auto* row = pixels.ptr<uint16_t>(y);
    for (int x = 0; x < pixels.cols; ++x) depth.at(x, y) = static_cast<float>(row[x] * metres_per_unit);
  }
  return depth;
}

ValidityMask read_mask(const std::filesystem::path& file) {
  const Image image = read_image(file);
  ValidityMask mask(image.width, image.height);
  for (size_t i = 0; i < mask.valid.size(); ++i) {
    mask.valid[i] = image.rgb[3 * i] + image.rgb[3 * i + 1] + image.rgb[3 * i + 2] > 382 ? 1 : 0;
  }
  return mask;
}

void write_png(const std::filesystem::path& file, const Image& image) {
  write_file_atomically(file, encode_png(image, {}));
}

void write_jpeg(const std::filesystem::path& file, const Image& image, int quality) {
  write_file_atomically(file, encode_jpeg(image, quality, file.string()));
}

}  // namespace gld
