#pragma once

#include "datasets/images/decoded_pixels.h"
#include "datasets/images/image.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace gld {

struct JpegHeader {
  int64_t width = 0;   // as stored
  int64_t height = 0;  // as stored
  std::string exif;    // metadata behind kExifStart; empty when there are none
  size_t pixels = 0;   // where the compressed pixels begin, behind all that is said about them
};

// Reads what stands before the pixels. Throws Error where the bytes end before them or libjpeg complains.
JpegHeader read_jpeg_header(std::string_view bytes, const std::string& where);

// Decodes a whole JPEG file in memory as OpenCV does (the same bits), but takes nothing that libjpeg had to repair: the
// library goes on after broken data with grey or shifted blocks and says so on the terminal only. Here its first
// complaint ends up in the Error. What it cannot notice stays unnoticed, for JPEG files have no checksum. CMYK becomes
// blue, green, red.
DecodedPixels decode_jpeg(const std::string& bytes, const std::string& where);

// Returns the bytes of a JPEG file of that quality, 1 to 100, with half the resolution in colour. Equal input gives
// equal bytes. Throws Error when the image has no pixels or more in a row than the format holds.
std::string encode_jpeg(const Image& image, int quality, const std::string& where);

}  // namespace gld
