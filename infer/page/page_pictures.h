#pragma once

#include "datasets/images/image.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Longest side of a picture inside a page; larger ones are averaged down.
constexpr int64_t kPagePictureSide = 1280;

// The pictures of a page, by number.
class PagePictures {
 public:
  // Returns its number.
  int64_t add(const Image& image);

  // Returns addresses ("data:image/png;base64,...") for all of them: they are PNG where that comes to at most so many
  // bytes, else the smaller of PNG and JPEG each, of the best quality of 95, 90, 80 and 70 with which it does, else of
  // 70.
  std::vector<std::string> addresses(size_t most_bytes) const;

 private:
  std::vector<Image> images_;
};

}  // namespace gld
