#include "datasets/images/decoded_pixels.h"

#include "datasets/images/image.h"
#include "gld/base/error.h"

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

}  // namespace gld
