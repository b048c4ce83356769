#pragma once

#include "datasets/images/decoded_pixels.h"

#include <cstdint>
#include <string>
#include <string_view>

namespace gld {

// A BMP file's description of its pixels.
struct BmpHeader {
  int64_t width = 0;
  int64_t height = 0;
  bool top_row_first = false;
  int bits = 0;           // of a pixel: 1, 4, 8, 16, 24 or 32
  uint64_t palette = 0;   // where it begins
  int palette_entry = 0;  // bytes of a colour: 3 or 4
  int64_t palette_size = 0;
  uint64_t pixels = 0;     // where they begin
  uint32_t masks[4] = {};  // of red, green, blue and alpha in pixels of 16 and 32 bits; 0 without that colour
};

// Error where the bytes are too few or the file is of a kind that is not read: compressed ones are not, as no camera
// and few programs write them.
BmpHeader read_bmp_header(std::string_view bytes, const std::string& where);

// 3 channels, or 4 where the file says that it has alpha. A size that the file cannot hold is refused before memory is
// taken.
DecodedPixels decode_bmp(std::string_view bytes, const std::string& where);

}  // namespace gld
