#pragma once

#include "datasets/images/image.h"
#include "datasets/images/png_file.h"
#include "gld/base/atomic_file.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

namespace gld::test {

// Writes a 16-bit PNG of round(metres / metres_per_unit), saturating.
inline void write_depth_png(const std::filesystem::path& file, const DepthMap& depth,
                            double metres_per_unit) {
  Grey16 pixels{depth.width, depth.height, {}};
  for (const float metres : depth.metres) {
    const double units = std::round(metres / metres_per_unit);
    pixels.values.push_back(static_cast<uint16_t>(std::clamp(units, 0.0, 65535.0)));
  }
  write_file_atomically(file, encode_png(pixels, {}));
}

}  // namespace gld::test
