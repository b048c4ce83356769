#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace gld {

// The kinds of image files that are read.
enum class ImageFormat { kPng, kJpeg, kWebp, kTiff, kHeif };  // kHeif: HEIC

// Returns what a file's first 12 bytes say, whatever its name; nothing where it is none of them.
std::optional<ImageFormat> image_format(std::string_view bytes);

// Returns the names in a sentence: "PNG, JPEG, WebP, TIFF or HEIC".
const std::string& image_format_names();

// Returns how names of such files end, in small letters with the dot; first come the kinds that a scene is likelier to
// have.
const std::vector<std::string>& image_extensions();

}  // namespace gld
