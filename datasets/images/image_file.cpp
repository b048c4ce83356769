#include "datasets/images/image_file.h"

#include "datasets/images/image_probe.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

[[noreturn]] void fail_damaged(const std::string& where) {
  fail({where, "an image that can be decoded", "damaged data", "copy or download it again"});
}

// The file is decoded from memory so that what was probed is what is decoded.
cv::Mat decode(const std::string& bytes, int flags, const std::string& where) {
  const cv::Mat buffer(1, static_cast<int>(bytes.size()), CV_8UC1, const_cast<char*>(bytes.data()));
  cv::Mat decoded;
  try {
    decoded = cv::imdecode(buffer, flags | cv::IMREAD_IGNORE_ORIENTATION);
  } catch (const cv::Exception&) {
    fail_damaged(where);
  }
  if (decoded.empty()) fail_damaged(where);
  return decoded;
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

cv::Mat bgr_view(const Image& image, const std::string& where) {
  if (image.width < 1 || image.height < 1 ||
      image.rgb.size() != static_cast<size_t>(3 * image.width * image.height)) {
    fail({where, "an image with 3 bytes a pixel", std::to_string(image.rgb.size()) + " bytes", {}});
  }
  const cv::Mat rgb(static_cast<int>(image.height), static_cast<int>(image.width), CV_8UC3,
                    const_cast<uint8_t*>(image.rgb.data()));
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  return bgr;
}

void write_encoded(const std::filesystem::path& file, const std::string& extension, const cv::Mat& pixels,
                   const std::vector<int>& parameters) {
  std::vector<uint8_t> bytes;
  if (!cv::imencode(extension, pixels, bytes, parameters)) {
    fail(
        {file.string(), "to write_encoded an image", "an encoder error", "check the installation of OpenCV"});
  }
  write_file_atomically(file, std::string(bytes.begin(), bytes.end()));
}

}  // namespace

Image read_image(const std::filesystem::path& file, ImageOrientation orientation) {
  const std::string bytes = read_file(file);
  const std::string where = file.string();
  const ImageFileInfo info = probe_image_bytes(bytes, where);
  cv::Mat pixels = to_eight_bits(decode(bytes, cv::IMREAD_UNCHANGED, where), where);
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
  const std::string bytes = read_file(file);
  const std::string where = file.string();
  probe_image_bytes(bytes, where);
  const cv::Mat pixels = decode(bytes, cv::IMREAD_UNCHANGED, where);
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
  write_encoded(file, ".png", bgr_view(image, file.string()), {cv::IMWRITE_PNG_COMPRESSION, 6});
}

void write_jpeg(const std::filesystem::path& file, const Image& image, int quality) {
  write_encoded(file, ".jpg", bgr_view(image, file.string()), {cv::IMWRITE_JPEG_QUALITY, quality});
}

void write_depth_png(const std::filesystem::path& file, const DepthMap& depth, double metres_per_unit) {
  cv::Mat pixels(static_cast<int>(depth.height), static_cast<int>(depth.width), CV_16UC1);
  for (int y = 0; y < pixels.rows; ++y) {
    auto* row = pixels.ptr<uint16_t>(y);
    for (int x = 0; x < pixels.cols; ++x) {
      row[x] = static_cast<uint16_t>(std::clamp(std::round(depth.at(x, y) / metres_per_unit), 0.0, 65535.0));
    }
  }
  write_encoded(file, ".png", pixels, {cv::IMWRITE_PNG_COMPRESSION, 6});
}

}  // namespace gld
