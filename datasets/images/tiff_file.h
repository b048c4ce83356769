#pragma once

#include "datasets/images/decoded_pixels.h"

#include <cstdint>
#include <string>
#include <string_view>

namespace gld {

struct TiffHeader {
  int64_t width = 0;    // as stored
  int64_t height = 0;   // as stored
  int orientation = 1;  // 1..8 as in EXIF metadata, whose tag this is
};

// Reads the header of the file's first picture. Its directory may stand anywhere: the bytes must be those of the whole
// file.
TiffHeader read_tiff_header(std::string_view bytes, const std::string& where);

// Returns the first picture as stored, as 8-bit blue, green and red; what is transparent lies over white. It takes
// integer samples of up to 16 bits in any colours that libtiff knows, uncompressed or as LZW, deflate, PackBits or
// JPEG. Other files, and whatever libtiff complains about in the pixels, end up in the Error.
DecodedPixels decode_tiff(std::string_view bytes, const std::string& where);

}  // namespace gld
