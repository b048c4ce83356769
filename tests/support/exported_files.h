#pragma once

#include "datasets/images/image.h"
#include "gld/base/atomic_file.h"
#include "gld/files/npy.h"
#include "gld/photogrammetry/view_maps.h"
#include "gld/report/provenance.h"

#include <cstring>
#include <filesystem>
#include <sstream>
#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

// Readers of what the program exports, for files that are whole.
namespace gld::test {

// Returns the value of a name; empty when there is none.
inline std::string find_text(const TextItems& items, const std::string& name) {
  for (const auto& [key, text] : items) {
    if (key == name) return text;
  }
  return {};
}

// Returns the texts of a PNG file's tEXt and uncompressed iTXt chunks, in its order. Its checksums are left to
// read_image.
inline TextItems read_png_texts(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  const std::string_view view = bytes;
  TextItems texts;
  constexpr size_t kSignature = 8, kFrame = 12;  // length, type and checksum stand around a chunk's data
  for (size_t at = kSignature; at + kFrame <= view.size();) {
    size_t length = 0;
    for (size_t i = 0; i < 4; ++i) length = length << 8 | static_cast<uint8_t>(view[at + i]);
    const std::string_view type = view.substr(at + 4, 4), data = view.substr(at + 8, length);
    if (type == "tEXt" || type == "iTXt") {
      const size_t name = data.find('\0');
      // Behind the name of iTXt stand two bytes about compression, and a language in two words that are left empty.
      texts.emplace_back(data.substr(0, name), data.substr(name + (type == "tEXt" ? 1 : 5)));
    }
    at += kFrame + length;
  }
  return texts;
}

// Reads a one-channel little-endian PFM file, whose rows go from bottom to top.
inline DepthMap read_pfm(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  std::istringstream stream(bytes);
  std::string magic;
  int64_t width = 0, height = 0;
  double scale = 0;
  stream >> magic >> width >> height >> scale;
  DepthMap depth(width, height);
  const size_t header = bytes.size() - 4 * depth.metres.size();
  for (int64_t y = 0; y < height; ++y) {
    std::memcpy(&depth.at(0, height - 1 - y), bytes.data() + header + 4 * static_cast<size_t>(y * width),
                4 * static_cast<size_t>(width));
  }
  return depth;
}

struct RayFile {
  RayMap rays;
  ConfidenceMap confidence;
  TextItems provenance;
};

inline RayFile read_rays(const std::filesystem::path& file) {
  const NpzFile npz = NpzFile::open(file);
  const NpyArray rays = npz.read("rays"), provenance = npz.read("provenance");
  RayFile result;
  result.rays = RayMap(rays.shape.at(1), rays.shape.at(0));
  result.rays.values = rays.to_floats();
  result.confidence = ConfidenceMap(rays.shape.at(1), rays.shape.at(0));
  result.confidence.values = npz.read("confidence").to_floats();
  const auto items = nlohmann::ordered_json::parse(provenance.bytes.begin(), provenance.bytes.end());
  for (const auto& [name, text] : items.items())
    result.provenance.emplace_back(name, text.get<std::string>());
  return result;
}

}  // namespace gld::test
