#include "infer/page/page_pictures.h"

#include "datasets/images/jpeg_file.h"
#include "datasets/images/png_file.h"
#include "datasets/scenes/resize_crop.h"
#include "gld/page/page_text.h"

#include <algorithm>

namespace gld {
namespace {

size_t total_size(const std::vector<std::string>& texts) {
  size_t sum = 0;
  for (const std::string& text : texts) sum += text.size();
  return sum;
}

// Returns a side reduced so that the longest one fits; the other one is rounded to whole pixels.
int64_t reduced_side(int64_t side, int64_t longest) {
  return std::max<int64_t>(2, (side * kPagePictureSide + longest / 2) / longest);
}

}  // namespace

int64_t PagePictures::add(const Image& image) {
  const int64_t longest = std::max(image.width, image.height);
  if (longest > kPagePictureSide) {
    const ImageSize size{reduced_side(image.width, longest), reduced_side(image.height, longest)};
    images_.push_back(resize_crop(image, plan_resize_crop(image.width, image.height, size)));
  } else {
    images_.push_back(image);
  }
  return static_cast<int64_t>(images_.size()) - 1;
}

std::vector<std::string> PagePictures::addresses(size_t most_bytes) const {
  std::vector<std::string> lossless;
  lossless.reserve(images_.size());
  for (const Image& image : images_) lossless.push_back(data_address("image/png", encode_png(image, {})));
  if (total_size(lossless) <= most_bytes) return lossless;
  std::vector<std::string> chosen;
  for (const int quality : {95, 90, 80, 70}) {
    chosen = lossless;
    for (size_t i = 0; i < images_.size(); ++i) {
      std::string lossy = data_address("image/jpeg", encode_jpeg(images_[i], quality, "a picture of a page"));
      if (lossy.size() < chosen[i].size()) chosen[i] = std::move(lossy);
    }
    if (total_size(chosen) <= most_bytes) break;
  }
  return chosen;
}

}  // namespace gld
