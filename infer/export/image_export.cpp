#include "infer/export/image_export.h"

#include "datasets/images/png_file.h"
#include "gld/base/atomic_file.h"

#include <algorithm>
#include <cmath>

namespace gld {

std::string view_name(int64_t view, int64_t num_views) {
  const std::string digits = std::to_string(view);
  const size_t length = std::max<size_t>(2, std::to_string(std::max<int64_t>(num_views - 1, 0)).size());
  return "view_" + std::string(length - std::min(length, digits.size()), '0') + digits;
}

void export_image(const std::filesystem::path& file, const Image& image, const Provenance& provenance,
                  const TextItems& more) {
  TextItems texts = provenance_items(provenance);
  texts.insert(texts.end(), more.begin(), more.end());
  write_file_atomically(file, encode_png(image, texts));
}

Image image_from_planes(const float* planes, int64_t width, int64_t height) {
  Image image(width, height);
  const int64_t pixels = width * height;
  for (int64_t i = 0; i < pixels; ++i) {
    for (int64_t channel = 0; channel < 3; ++channel) {
      const float value = planes[channel * pixels + i];
      // The comparison is false for NaN, whose conversion to an integer is undefined.
      const float clamped = value > 0 ? std::min(value, 1.0F) : 0.0F;
      image.rgb[static_cast<size_t>(3 * i + channel)] = static_cast<uint8_t>(std::lround(clamped * 255.0F));
    }
  }
  return image;
}

}  // namespace gld
