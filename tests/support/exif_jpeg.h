#pragma once

#include "gld/base/atomic_file.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace gld::test {

// What EXIF metadata say of a picture; 0 leaves an entry out.
struct ExifEntries {
  uint16_t orientation = 0;
  uint16_t focal_length_in_35mm_film = 0;
  uint32_t focal_length = 0;              // mm
  uint32_t focal_plane_x_resolution = 0;  // pixels a unit
  uint16_t focal_plane_unit = 0;          // 2 inch, 3 cm
  uint32_t pixel_x = 0, pixel_y = 0;
};

class ExifDirectory {
 public:
  void add_short(uint16_t tag, uint16_t value) {
    if (value != 0) add(tag, 3, value);
  }
  void add_long(uint16_t tag, uint32_t value) {
    if (value != 0) add(tag, 4, value);
  }
  // The value is written over 1; its eight bytes stand behind the directory.
  void add_rational(uint16_t tag, uint32_t value) {
    if (value == 0) return;
    rationals_.push_back({entries_.size(), value});
    add(tag, 5, 0);
  }
  // offset is where the directory begins.
  std::string bytes(uint32_t offset) {
    const auto end = static_cast<uint32_t>(offset + 2 + 12 * entries_.size() + 4);
    std::string values;
    for (const auto& [entry, value] : rationals_) {
      entries_[entry].replace(8, 4, number(static_cast<uint32_t>(end + values.size()), 4));
      values += number(value, 4) + number(1, 4);
    }
    std::string text = number(static_cast<uint32_t>(entries_.size()), 2);
    for (const std::string& entry : entries_) text += entry;
    return text + number(0, 4) + values;
  }

  static std::string number(uint32_t value, int bytes) {
    std::string text;
    for (int i = 0; i < bytes; ++i) text += static_cast<char>(value >> (8 * i) & 0xFF);
    return text;
  }

 private:
  struct Rational {
    size_t entry;
    uint32_t value;
  };
  void add(uint16_t tag, uint32_t type, uint32_t value) {
    entries_.push_back(number(tag, 2) + number(type, 2) + number(1, 4) + number(value, 4));
  }
  std::vector<std::string> entries_;
  std::vector<Rational> rationals_;
};

// Puts metadata into a JPEG file that has none.
inline void add_exif(const std::filesystem::path& jpeg, const ExifEntries& exif) {
  constexpr uint32_t kFirst = 8;
  ExifDirectory picture, camera;
  camera.add_rational(0x920A, exif.focal_length);
  camera.add_long(0xA002, exif.pixel_x);
  camera.add_long(0xA003, exif.pixel_y);
  camera.add_rational(0xA20E, exif.focal_plane_x_resolution);
  camera.add_short(0xA210, exif.focal_plane_unit);
  camera.add_short(0xA405, exif.focal_length_in_35mm_film);
  picture.add_short(0x0112, exif.orientation);
  const uint32_t entries = exif.orientation != 0 ? 2 : 1;
  const uint32_t second = kFirst + 2 + 12 * entries + 4;
  picture.add_long(0x8769, second);
  const std::string body = std::string("Exif\0\0", 6) + std::string("II*\0", 4) +
                           ExifDirectory::number(kFirst, 4) + picture.bytes(kFirst) + camera.bytes(second);
  const size_t length = body.size() + 2;
  const std::string segment =
      std::string("\xFF\xE1") + static_cast<char>(length >> 8) + static_cast<char>(length & 0xFF) + body;
  const std::string bytes = read_file(jpeg);
  write_file_atomically(jpeg, bytes.substr(0, 2) + segment + bytes.substr(2));
}

}  // namespace gld::test
