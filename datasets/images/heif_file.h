#pragma once

#include "datasets/images/decoded_pixels.h"

#include <cstdint>
#include <string>
#include <string_view>

namespace gld {

struct HeifHeader {
  int64_t width =
      0;  // of the picture as it is shown: the file turns and mirrors it itself, whatever EXIF says
  int64_t height = 0;
  std::string exif;  // metadata behind kExifStart; empty when there are none
};

// Reads what stands beside the pixels of HEIC, which telephones write, for the one picture of a file that is shown
// first. Throws Error with libheif's words where the bytes are no such file.
HeifHeader read_heif_header(std::string_view bytes, const std::string& where);

// Returns that picture, turned as it is shown, with 8 bits a channel (libheif brings what has more down to that), 3
// channels or 4. Whatever libheif complains about ends up in the Error. Damage that gives other pixels stays unnoticed:
// the files have no checksum.
DecodedPixels decode_heif(std::string_view bytes, const std::string& where);

}  // namespace gld
