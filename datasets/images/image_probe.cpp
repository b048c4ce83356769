#include "datasets/images/image_probe.h"

#include "datasets/images/bmp_file.h"
#include "datasets/images/decoded_pixels.h"
#include "datasets/images/image_format.h"
#include "datasets/images/tiff_file.h"
#include "datasets/images/webp_file.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/mapped_file.h"

#include <algorithm>
#include <fstream>
#include <memory>
#include <string_view>

#include <libexif/exif-data.h>

namespace gld {
namespace {

constexpr uint64_t kLargestProbedFile = uint64_t{1} << 30;
// More than most headers have; otherwise the whole file is read.
constexpr std::streamsize kHeaderBytes = 1 << 18;
const std::string kExifStart("Exif\0\0", 6);

// How much of a file is looked at.
enum class Extent { kHeader, kWhole };

[[noreturn]] void fail_truncated(const std::string& where) {
  fail({where, "a whole image file", "one that ends early", "copy or download it again"});
}

class Bytes {
 public:
  Bytes(std::string_view bytes, const std::string& where) : bytes_(bytes), where_(where) {}
  size_t size() const { return bytes_.size(); }
  uint8_t at(size_t offset) const {
    if (offset >= bytes_.size()) fail_truncated(where_);
    return static_cast<uint8_t>(bytes_[offset]);
  }
  uint32_t big16(size_t offset) const { return at(offset) << 8 | at(offset + 1); }
  uint32_t big32(size_t offset) const { return big16(offset) << 16 | big16(offset + 2); }

 private:
  std::string_view bytes_;
  const std::string& where_;
};

// The orientation that EXIF metadata ("Exif", two zeros, a TIFF structure) ask for; 1 when they have none or are
// damaged: a picture with broken metadata is still a picture. OpenCV would turn the picture and not say so, but cameras
// may belong to the picture as stored.
int exif_orientation(const std::string& metadata) {
  const std::unique_ptr<ExifData, decltype(&exif_data_unref)> exif(exif_data_new(), exif_data_unref);
  if (!exif) return 1;
  // Otherwise missing entries are made up.
  exif_data_unset_option(exif.get(), EXIF_DATA_OPTION_FOLLOW_SPECIFICATION);
  exif_data_load_data(exif.get(), reinterpret_cast<const unsigned char*>(metadata.data()),
                      static_cast<unsigned int>(metadata.size()));
  const ExifEntry* entry = exif_content_get_entry(exif->ifd[EXIF_IFD_0], EXIF_TAG_ORIENTATION);
  if (entry == nullptr || entry->format != EXIF_FORMAT_SHORT || entry->size < 2) return 1;
  const ExifShort value = exif_get_short(entry->data, exif_data_get_byte_order(exif.get()));
  return value >= 1 && value <= 8 ? value : 1;
}

ImageFileInfo probe_png(const Bytes& bytes, std::string_view text, Extent extent, const std::string& where) {
  ImageFileInfo info;
  info.width = bytes.big32(16);
  info.height = bytes.big32(20);
  size_t offset = 8;
  while (true) {
    const size_t length = bytes.big32(offset);
    const uint32_t type = bytes.big32(offset + 4);
    const size_t next = offset + 12 + length;
    if (type == 0x49444154 && extent == Extent::kHeader) return info;  // IDAT
    if (next > bytes.size()) fail_truncated(where);
    if (type == 0x65584966) {  // eXIf
      info.orientation = exif_orientation(kExifStart + std::string(text.substr(offset + 8, length)));
    }
    if (type == 0x49454E44) return info;  // IEND
    offset = next;
  }
}

bool is_frame_header(uint8_t marker) {
  // C4, C8 and CC share the number range but are tables and extensions.
  return marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
}

// An end-of-image marker cannot occur inside compressed data, where 0xFF is always followed by 0.
bool has_end_marker(std::string_view bytes, size_t scan) {
  const char marker[] = {'\xFF', '\xD9'};
  return std::search(bytes.begin() + static_cast<std::ptrdiff_t>(scan), bytes.end(), marker, marker + 2) !=
         bytes.end();
}

ImageFileInfo probe_jpeg(const Bytes& bytes, std::string_view text, Extent extent, const std::string& where) {
  ImageFileInfo info;
  size_t offset = 2;
  while (true) {
    while (bytes.at(offset) != 0xFF) ++offset;
    while (bytes.at(offset) == 0xFF) ++offset;  // fill bytes
    const uint8_t marker = bytes.at(offset++);
    if (marker == 0x00 || marker == 0x01 || (marker >= 0xD0 && marker <= 0xD8)) continue;
    if (marker == 0xD9) fail_truncated(where);
    const size_t length = bytes.big16(offset);
    if (length < 2 || offset + length > bytes.size()) fail_truncated(where);
    if (is_frame_header(marker)) {
      info.height = bytes.big16(offset + 3);
      info.width = bytes.big16(offset + 5);
    }
    if (marker == 0xE1 && text.compare(offset + 2, kExifStart.size(), kExifStart) == 0) {
      info.orientation = exif_orientation(std::string(text.substr(offset + 2, length - 2)));
    }
    if (marker == 0xDA) {
      if (extent == Extent::kWhole && !has_end_marker(text, offset)) fail_truncated(where);
      return info;
    }
    offset += length;
  }
}

ImageFileInfo probe_webp(std::string_view bytes, Extent extent, const std::string& where) {
  const WebpHeader header = read_webp_header(bytes, where);
  if (extent == Extent::kWhole && !header.whole) fail_truncated(where);
  return {header.width, header.height, header.exif.empty() ? 1 : exif_orientation(header.exif)};
}

ImageFileInfo probe_tiff(std::string_view bytes, const std::string& where) {
  const TiffHeader header = read_tiff_header(bytes, where);
  return {header.width, header.height, header.orientation};
}

ImageFileInfo probe_bmp(std::string_view bytes, const std::string& where) {
  const BmpHeader header = read_bmp_header(bytes, where);
  return {header.width, header.height, 1};
}

ImageFileInfo probe_format(std::string_view bytes, Extent extent, const std::string& where) {
  const auto format = image_format(bytes);
  if (!format) {
    fail({where, "a " + image_format_names() + " image", bytes.empty() ? "an empty file" : "something else",
          "convert it"});
  }
  switch (*format) {
    case ImageFormat::kJpeg:
      return probe_jpeg(Bytes(bytes, where), bytes, extent, where);
    case ImageFormat::kWebp:
      return probe_webp(bytes, extent, where);
    case ImageFormat::kTiff:
      return probe_tiff(bytes, where);
    case ImageFormat::kBmp:
      return probe_bmp(bytes, where);
    case ImageFormat::kPng:
      break;
  }
  return probe_png(Bytes(bytes, where), bytes, extent, where);
}

ImageFileInfo probe(std::string_view bytes, Extent extent, const std::string& where) {
  const ImageFileInfo info = probe_format(bytes, extent, where);
  if (info.width < 2 || info.height < 2) {
    fail({where, "an image at least 2 pixels wide and high",
          std::to_string(info.width) + "x" + std::to_string(info.height), "leave it out"});
  }
  check_picture_size(info.width, info.height, where);
  return info;
}

bool ends_with(std::string_view bytes, std::string_view end) {
  return bytes.size() >= end.size() && bytes.substr(bytes.size() - end.size()) == end;
}

// Whether the last bytes are those of a whole file; where not, more may stand behind its end.
bool has_usual_end(std::string_view bytes) {
  const auto format = image_format(bytes);
  if (format == ImageFormat::kPng) return ends_with(bytes, {"\0\0\0\0IEND\xAE\x42\x60\x82", 12});
  return format == ImageFormat::kJpeg && ends_with(bytes, "\xFF\xD9");
}

}  // namespace

ImageFileInfo probe_image_bytes(const std::string& bytes, const std::string& where) {
  return probe(bytes, Extent::kWhole, where);
}

void check_image_end(const std::filesystem::path& file) {
  const auto mapped = MappedFile::open(file);
  const ByteView view = mapped->bytes();
  const std::string_view bytes(reinterpret_cast<const char*>(view.data), view.size);
  if (!has_usual_end(bytes)) probe(bytes, Extent::kWhole, file.string());
}

ImageFileInfo probe_image_file(const std::filesystem::path& file) {
  std::error_code error;
  const auto size = std::filesystem::file_size(file, error);
  if (!error && size > static_cast<uintmax_t>(kHeaderBytes)) {
    std::string start(static_cast<size_t>(kHeaderBytes), '\0');
    std::ifstream stream(file, std::ios::binary);
    if (stream.read(start.data(), kHeaderBytes)) {
      try {
        return probe(start, Extent::kHeader, file.string());
      } catch (const Error&) {
        // Either wrong, or a longer header, or one that stands behind the pixels: the whole file tells.
      }
    }
  }
  if (!error && size > static_cast<uintmax_t>(kHeaderBytes) && size <= kLargestProbedFile) {
    const auto mapped = MappedFile::open(file);
    const ByteView bytes = mapped->bytes();
    return probe({reinterpret_cast<const char*>(bytes.data), bytes.size}, Extent::kHeader, file.string());
  }
  return probe(read_file(file, kLargestProbedFile), Extent::kHeader, file.string());
}

}  // namespace gld
