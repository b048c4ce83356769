#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

namespace gld {

// What the header of an image file (datasets/images/image_format.h) says, without decoding it.
struct ImageFileInfo {
  int64_t width = 0;    // as stored
  int64_t height = 0;   // as stored
  int orientation = 1;  // EXIF orientation, 1..8; 1 when the file has none

  // True for the four orientations that swap width and height.
  bool turned() const { return orientation >= 5; }
};

// Reads no more than the header, so that opening a scene of many large photographs is quick. Throws Error when the file
// is missing, is no image, ends within the header, or is one pixel wide or high.
ImageFileInfo probe_image_file(const std::filesystem::path& file);

// Throws Error where the file ends early, as far as its structure tells without decoding: by the last bytes of a PNG,
// JPEG or WebP file, or what leads to them. Of TIFF and BMP files it looks at the header.
void check_image_end(const std::filesystem::path& file);

// The same as probe_image_file for a whole file in memory, and an Error when it
// ends early anywhere; where names it in errors.
ImageFileInfo probe_image_bytes(const std::string& bytes, const std::string& where);

}  // namespace gld
