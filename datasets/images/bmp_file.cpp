#include "datasets/images/bmp_file.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cstddef>

namespace gld {
namespace {

// Header sizes, each an extension of the one before: OS/2's, Windows 3's, then with masks, colour spaces and profiles.
constexpr uint32_t kCoreHeader = 12;
constexpr uint32_t kInfoHeader = 40;
constexpr uint32_t kMaskHeader = 52;
constexpr uint32_t kAlphaMaskHeader = 56;
constexpr uint32_t kV4Header = 108;
constexpr uint32_t kV5Header = 124;
constexpr uint64_t kFileHeader = 14;

enum BmpCompression : uint32_t { kPlain = 0, kBitFields = 3, kAlphaBitFields = 6 };

[[noreturn]] void fail_short_bmp(const std::string& where) {
  fail({where, "a whole image file", "one that ends early", "copy or download it again"});
}

class BmpBytes {
 public:
  BmpBytes(std::string_view bytes, const std::string& where) : bytes_(bytes), where_(where) {}
  uint8_t at(uint64_t offset) const {
    if (offset >= bytes_.size()) fail_short_bmp(where_);
    return static_cast<uint8_t>(bytes_[offset]);
  }
  uint32_t little16(uint64_t offset) const {
    return static_cast<uint32_t>(at(offset)) | static_cast<uint32_t>(at(offset + 1)) << 8;
  }
  uint32_t little32(uint64_t offset) const { return little16(offset) | little16(offset + 2) << 16; }
  int64_t signed32(uint64_t offset) const { return static_cast<int32_t>(little32(offset)); }

 private:
  std::string_view bytes_;
  const std::string& where_;
};

[[noreturn]] void fail_other_bmp(const std::string& where, const std::string& found) {
  fail({where, "an uncompressed BMP file", found, "convert it to PNG"});
}

void set_masks(BmpHeader& header, const BmpBytes& bytes, uint32_t header_size, uint32_t compression) {
  if (compression == kPlain) {
    // 5 bits a colour, or 8.
    const bool wide = header.bits == 32;
    header.masks[0] = wide ? 0xFF0000 : 0x7C00;
    header.masks[1] = wide ? 0xFF00 : 0x3E0;
    header.masks[2] = wide ? 0xFF : 0x1F;
    return;
  }
  const bool alpha = header_size >= kAlphaMaskHeader || compression == kAlphaBitFields;
  for (uint64_t c = 0; c < (alpha ? 4U : 3U); ++c) {
    header.masks[c] = bytes.little32(kFileHeader + kInfoHeader + 4 * c);
  }
}

// The value under a mask as 8 bits; 0 without a mask.
uint8_t masked(uint32_t pixel, uint32_t mask) {
  if (mask == 0) return 0;
  const uint32_t lowest = mask & (~mask + 1);
  const uint64_t largest = mask / lowest;
  return static_cast<uint8_t>((uint64_t{(pixel & mask) / lowest} * 255 + largest / 2) / largest);
}

int64_t bmp_stride(const BmpHeader& header) { return (header.width * header.bits + 31) / 32 * 4; }

using Row = std::string_view;

void unpack_indexed(const BmpHeader& header, Row row, std::string_view palette, uint8_t* to,
                    const std::string& where) {
  const int per_byte = 8 / header.bits;
  const int mask = (1 << header.bits) - 1;
  for (int64_t x = 0; x < header.width; ++x) {
    const int shift = 8 - header.bits * static_cast<int>(x % per_byte + 1);
    const int index = static_cast<uint8_t>(row[static_cast<size_t>(x / per_byte)]) >> shift & mask;
    if (index >= header.palette_size) {
      fail({where, "colours of its table of " + std::to_string(header.palette_size),
            "colour " + std::to_string(index), "copy or download it again"});
    }
    for (size_t c = 0; c < 3; ++c) {
      to[3 * x + static_cast<int64_t>(c)] =
          static_cast<uint8_t>(palette[static_cast<size_t>(index * header.palette_entry) + c]);
    }
  }
}

void unpack_masked(const BmpHeader& header, Row row, uint8_t* to, int channels) {
  const int bytes = header.bits / 8;
  for (int64_t x = 0; x < header.width; ++x) {
    uint32_t pixel = 0;
    for (int k = 0; k < bytes; ++k) {
      pixel |= static_cast<uint32_t>(static_cast<uint8_t>(row[static_cast<size_t>(x * bytes + k)])) << 8 * k;
    }
    uint8_t* colours = to + x * channels;
    for (int c = 0; c < 3; ++c) colours[c] = masked(pixel, header.masks[2 - c]);
    if (channels == 4) colours[3] = masked(pixel, header.masks[3]);
  }
}

}  // namespace

BmpHeader read_bmp_header(std::string_view text, const std::string& where) {
  const BmpBytes bytes(text, where);
  BmpHeader header;
  header.pixels = bytes.little32(10);
  const uint32_t size = bytes.little32(kFileHeader);
  const bool core = size == kCoreHeader;
  if (!core && size != kInfoHeader && size != kMaskHeader && size != kAlphaMaskHeader && size != kV4Header &&
      size != kV5Header) {
    fail_other_bmp(where, "a header of " + std::to_string(size) + " bytes");
  }
  int64_t height = 0;
  if (core) {
    header.width = bytes.little16(18);
    height = bytes.little16(20);
    header.bits = static_cast<int>(bytes.little16(24));
  } else {
    header.width = bytes.signed32(18);
    height = bytes.signed32(22);
    header.bits = static_cast<int>(bytes.little16(28));
  }
  header.top_row_first = height < 0;
  header.height = height < 0 ? -height : height;
  const uint32_t compression = core ? uint32_t{kPlain} : bytes.little32(30);
  const bool indexed = header.bits == 1 || header.bits == 4 || header.bits == 8;
  const bool by_masks = header.bits == 16 || header.bits == 32;
  if (!indexed && !by_masks && header.bits != 24) {
    fail_other_bmp(where, std::to_string(header.bits) + " bits a pixel");
  }
  if (compression != kPlain && !(by_masks && (compression == kBitFields || compression == kAlphaBitFields))) {
    fail_other_bmp(where, "compression " + std::to_string(compression));
  }
  if (by_masks) set_masks(header, bytes, size, compression);
  if (indexed) {
    const int64_t most = int64_t{1} << header.bits;
    const int64_t listed = core ? 0 : int64_t{bytes.little32(46)};
    header.palette_size = listed == 0 || listed > most ? most : listed;
    header.palette = kFileHeader + size;
    header.palette_entry = core ? 3 : 4;
  }
  return header;
}

DecodedPixels decode_bmp(std::string_view bytes, const std::string& where) {
  const BmpHeader header = read_bmp_header(bytes, where);
  check_picture_size(header.width, header.height, where);
  const auto stride = static_cast<uint64_t>(bmp_stride(header));
  const uint64_t palette_bytes = static_cast<uint64_t>(header.palette_size * header.palette_entry);
  if (header.pixels + stride * static_cast<uint64_t>(header.height) > bytes.size() ||
      header.palette + palette_bytes > bytes.size()) {
    fail_short_bmp(where);
  }
  DecodedPixels pixels;
  pixels.width = header.width;
  pixels.height = header.height;
  pixels.channels = header.masks[3] != 0 ? 4 : 3;
  const size_t row_bytes = static_cast<size_t>(header.width * pixels.channels);
  pixels.bytes.resize(row_bytes * static_cast<size_t>(header.height));
  for (int64_t y = 0; y < header.height; ++y) {
    const int64_t stored = header.top_row_first ? y : header.height - 1 - y;
    const Row row = bytes.substr(header.pixels + static_cast<uint64_t>(stored) * stride, stride);
    uint8_t* to = pixels.bytes.data() + static_cast<size_t>(y) * row_bytes;
    if (header.bits == 24) {
      std::copy(row.begin(), row.begin() + static_cast<std::ptrdiff_t>(row_bytes), to);
    } else if (header.bits < 16) {
      unpack_indexed(header, row, bytes.substr(header.palette, palette_bytes), to, where);
    } else {
      unpack_masked(header, row, to, pixels.channels);
    }
  }
  return pixels;
}

}  // namespace gld
