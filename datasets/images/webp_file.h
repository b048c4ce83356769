#pragma once

#include "datasets/images/decoded_pixels.h"

#include <cstdint>
#include <string>
#include <string_view>

namespace gld {

struct WebpHeader {
  int64_t width = 0;
  int64_t height = 0;
  std::string exif;    // metadata behind kExifStart; empty when there are none
  bool whole = false;  // whether the bytes hold the file to its end
};

// Reads what stands before the pixels and, where the bytes go that far, behind them. Throws Error where they are no
// WebP file or end before that is known: metadata stand behind the pixels.
WebpHeader read_webp_header(std::string_view bytes, const std::string& where);

// Returns a whole still picture, lossy or lossless, 3 channels or 4. Whatever libwebp complains about ends up in the
// Error, as do animations. Lossy files have no checksum: damage that gives other pixels stays unnoticed.
DecodedPixels decode_webp(std::string_view bytes, const std::string& where);

}  // namespace gld
