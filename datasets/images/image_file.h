#pragma once

#include "datasets/images/image.h"

#include <filesystem>

namespace gld {

// What to do with the rotation that EXIF metadata asks for. Cameras belong to one of the two pictures; the scene
// readers choose the one whose size is the camera's (datasets/formats/scene_builder.h).
enum class ImageOrientation {
  kAsStored,  // ignore EXIF
  kUpright,   // turn as EXIF says
};

// Reads an image file of any format of datasets/images/image_format.h as 8-bit RGB. 16-bit values are divided by 257,
// grey is repeated, transparent pixels are laid over white. Throws Error when the file is missing, damaged, ends early
// or is one pixel wide or high.
Image read_image(const std::filesystem::path& file,
                 ImageOrientation orientation = ImageOrientation::kAsStored);

// Reads a 16-bit single-channel PNG times metres_per_unit; 0 stays 0 (unknown).
DepthMap read_depth_png(const std::filesystem::path& file, double metres_per_unit);

// Reads a mask image: pixels above half brightness are valid.
ValidityMask read_mask(const std::filesystem::path& file);

// Writes a lossless file, which appears whole or not at all.
void write_png(const std::filesystem::path& file, const Image& image);

// Writes a photograph for a layout that wants JPEG; quality goes from 1 to 100.
void write_jpeg(const std::filesystem::path& file, const Image& image, int quality);

}  // namespace gld
