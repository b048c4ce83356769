#include "datasets/images/pfm_file.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <cmath>
#include <cstring>

namespace gld {

void write_pfm(const std::filesystem::path& file, const DepthMap& depth) {
  if (depth.empty() || depth.metres.size() != static_cast<size_t>(depth.width * depth.height)) {
    fail({file.string(), "a depth map with values",
          std::to_string(depth.width) + "x" + std::to_string(depth.height) + " with " +
              std::to_string(depth.metres.size()) + " values",
          "check what made it"});
  }
  // A negative scale says little-endian; its size would be a unit, which readers ignore.
  std::string bytes = "Pf\n" + std::to_string(depth.width) + " " + std::to_string(depth.height) + "\n-1.0\n";
  const size_t header = bytes.size();
  bytes.resize(header + 4 * depth.metres.size());
  char* out = bytes.data() + header;
  for (int64_t y = depth.height - 1; y >= 0; --y) {
    for (int64_t x = 0; x < depth.width; ++x, out += 4) {
      const float value = depth.at(x, y);
      const float written = value > 0 && std::isfinite(value) ? value : 0.0F;
      std::memcpy(out, &written, 4);
    }
  }
  write_file_atomically(file, bytes);
}

}  // namespace gld
