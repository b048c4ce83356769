#include "datasets/images/image_format.h"

namespace gld {
namespace {

bool starts_with(std::string_view bytes, std::string_view start) {
  return bytes.substr(0, start.size()) == start;
}

}  // namespace

std::optional<ImageFormat> image_format(std::string_view bytes) {
  using namespace std::string_view_literals;
  if (starts_with(bytes, "\x89PNG\r\n\x1A\n"sv)) return ImageFormat::kPng;
  if (starts_with(bytes, "\xFF\xD8"sv)) return ImageFormat::kJpeg;
  if (starts_with(bytes, "RIFF"sv) && bytes.size() >= 12 && bytes.substr(8, 4) == "WEBP"sv) {
    return ImageFormat::kWebp;
  }
  // Little-endian and big-endian, and the same with 64-bit offsets.
  for (const auto start : {"II\x2A\0"sv, "MM\0\x2A"sv, "II\x2B\0"sv, "MM\0\x2B"sv}) {
    if (starts_with(bytes, start)) return ImageFormat::kTiff;
  }
  if (bytes.size() >= 12 && bytes.substr(4, 4) == "ftyp"sv) {
    for (const auto brand : {"heic"sv, "heix"sv, "heim"sv, "heis"sv}) {
      if (bytes.substr(8, 4) == brand) return ImageFormat::kHeif;
    }
  }
  return std::nullopt;
}

const std::string& image_format_names() {
  static const std::string names = "PNG, JPEG, WebP, TIFF or HEIC";
  return names;
}

const std::vector<std::string>& image_extensions() {
  static const std::vector<std::string> extensions{".png",  ".jpg", ".jpeg", ".webp",
                                                   ".tiff", ".tif", ".heic", ".heif"};
  return extensions;
}

}  // namespace gld
