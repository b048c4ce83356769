#include "infer/export/image_export.h"

#include "datasets/images/png_file.h"
#include "gld/base/atomic_file.h"

#include <algorithm>

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

}  // namespace gld
