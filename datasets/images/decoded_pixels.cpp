#include "datasets/images/decoded_pixels.h"

#include "datasets/images/image.h"
#include "gld/base/error.h"

#include <algorithm>

namespace gld {

void check_picture_size(int64_t width, int64_t height, const std::string& where) {
  if (width >= 1 && height >= 1 && width <= kLargestSide && height <= kLargestSide &&
      width * height <= kMostPixels) {
    return;
  }
  fail({where,
        "a size of 1x1 to " + std::to_string(kMostPixels / 1'000'000) +
            " million pixels, each side at most " + std::to_string(kLargestSide),
        size_text(width, height), "check the file, or scale the picture down"});
}

void fail_short_image(const std::string& where) {
  fail({where, "a whole image file", "one that ends early", "copy or download it again"});
}

void check_compressed_picture_size(int64_t width, int64_t height, size_t file_bytes,
                                   const std::string& where) {
  check_picture_size(width, height, where);
  constexpr int64_t kAlways = int64_t{1} << 24;
  constexpr int64_t kPixelsPerByte = 4096;
  if (width * height <= std::max(kAlways, kPixelsPerByte * static_cast<int64_t>(file_bytes))) return;
  fail({where, "at most 4096 pixels for a byte of the file",
        size_text(width, height) + " in " + std::to_string(file_bytes) + " bytes",
        "check the file, or scale the picture down"});
}

}  // namespace gld
