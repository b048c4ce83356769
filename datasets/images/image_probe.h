#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

namespace gld {

// What the header of an image file (datasets/images/image_format.h) says, without decoding it.
struct ImageFileInfo {
  int64_t width = 0;    // as stored
  int64_t height = 0;   // as stored
  int orientation = 1;  // EXIF orientation, 1..8; 1 when the file has none
  // By EXIF, over the longer side of the picture (of the sensor, as of its picture); 0 where nothing tells.
  double focal_length = 0;

  // Returns true for the four orientations that swap width and height.
  bool turned() const { return orientation >= 5; }
};

// Looks at no more than the header, so that opening a scene of many large photographs is quick. Throws Error when the
// file is missing, is no image, ends within the header, or is one pixel wide or high, and with the words of the library
// that reads its format where the header is damaged. EXIF metadata of a PNG file count where they stand before the
// pixels.
ImageFileInfo probe_image_file(const std::filesystem::path& file);

// Does the same, and throws Error where the file ends early, as far as that can be told without decoding: a PNG or JPEG
// file has a mark at its end, a WebP file its length at the start. Of TIFF and HEIC files it looks at the header.
void check_image_end(const std::filesystem::path& file);

// Does the same as probe_image_file for a file in memory; where names it in errors.
ImageFileInfo probe_image_bytes(std::string_view bytes, const std::string& where);

}  // namespace gld
