#pragma once

#include "datasets/images/decoded_pixels.h"
#include "datasets/images/image.h"
#include "gld/report/provenance.h"

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace gld {

// 16-bit grey pixels, row by row, (height, width).
struct Grey16 {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<uint16_t> values;
};

// Returns the bytes of a lossless PNG file with the texts as chunks behind its header (tEXt, or iTXt where a text is
// not ASCII). Equal input gives equal bytes. Throws Error when the pixels are not width x height, or there are none, or
// a name or text cannot stand in a PNG file as it is.
std::string encode_png(const Image& image, const TextItems& texts);
std::string encode_png(const Grey16& image, const TextItems& texts);

struct PngHeader {
  int64_t width = 0;
  int64_t height = 0;
  std::string exif;  // metadata behind kExifStart; empty when there are none before the pixels
  TextItems texts;   // of the chunks before the pixels, in order; any bytes where another program wrote them
};

// Reads what stands before the pixels. Throws Error where the bytes end before them or libpng complains.
PngHeader read_png_header(std::string_view bytes, const std::string& where);

// Decodes a whole PNG file in memory: palettes and grey of few bits become 8 bits, transparency becomes a fourth
// channel (with grey repeated). Throws Error with libpng's words where a checksum is wrong anywhere, or anything is
// damaged.
DecodedPixels decode_png(const std::string& bytes, const std::string& where);

}  // namespace gld
