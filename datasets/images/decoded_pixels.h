#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace gld {

// Pixels as a file has them, row by row, in OpenCV's order of channels: grey, or blue, green, red and, with 4, alpha.
struct DecodedPixels {
  int64_t width = 0;
  int64_t height = 0;
  int channels = 0;  // 1, 3 or 4
  int bits = 8;      // of a channel: 8, or 16 in the machine's byte order
  std::vector<uint8_t> bytes;
};

// The most pixels that a picture or a map of depth may have: 16384 x 16384, more than any camera's photograph. A file
// of some hundred kilobytes can hold that many, so a size is compared before memory is taken for it.
constexpr int64_t kMostPixels = int64_t{1} << 28;
constexpr int64_t kLargestSide = 65535;

// Throws Error unless 1 <= sides <= kLargestSide and there are at most kMostPixels; where names the file.
void check_picture_size(int64_t width, int64_t height, const std::string& where);

// Throws the Error of a file whose bytes end before what they began; where names it.
[[noreturn]] void fail_short_image(const std::string& where);

// This is how EXIF metadata begin in a JPEG file, before a TIFF structure; libexif asks for it.
constexpr std::string_view kExifStart("Exif\0\0", 6);

// Checks a file whose few bytes may stand for any number of equal pixels: beyond what check_picture_size refuses, more
// than 2^24 pixels need a byte for 4096 of them, of which photographs have a thousand times as many.
void check_compressed_picture_size(int64_t width, int64_t height, size_t file_bytes,
                                   const std::string& where);

}  // namespace gld
