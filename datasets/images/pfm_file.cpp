#include "datasets/images/pfm_file.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <sstream>

namespace gld {
namespace {

constexpr int64_t kLargestPfmSide = 1 << 20;

}  // namespace

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

DepthMap read_pfm(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  std::istringstream stream(bytes.substr(0, 80));
  std::string magic;
  int64_t width = 0;
  int64_t height = 0;
  double scale = 0;
  stream >> magic >> width >> height >> scale;
  if (!stream || magic != "Pf" || width < 1 || height < 1 || width > kLargestPfmSide ||
      height > kLargestPfmSide || scale >= 0) {
    fail({file.string(), "a little-endian one-channel PFM file", "another header", "check the path"});
  }
  const size_t header = static_cast<size_t>(stream.tellg()) + 1;  // one white-space character ends it
  DepthMap depth;
  if (bytes.size() != header + 4 * static_cast<size_t>(width) * static_cast<size_t>(height)) {
    fail({file.string(), std::to_string(width) + "x" + std::to_string(height) + " values of 4 bytes",
          std::to_string(bytes.size() - std::min(header, bytes.size())) + " bytes", "write it again"});
  }
  depth = DepthMap(width, height);
  for (int64_t y = 0; y < height; ++y) {
    std::memcpy(depth.metres.data() + (height - 1 - y) * width,
                bytes.data() + header + 4 * static_cast<size_t>(y * width), 4 * static_cast<size_t>(width));
  }
  return depth;
}

}  // namespace gld
