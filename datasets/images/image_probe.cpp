#include "datasets/images/image_probe.h"

#include "datasets/images/decoded_pixels.h"
#include "datasets/images/heif_file.h"
#include "datasets/images/image.h"
#include "datasets/images/image_format.h"
#include "datasets/images/jpeg_file.h"
#include "datasets/images/png_file.h"
#include "datasets/images/tiff_file.h"
#include "datasets/images/webp_file.h"
#include "gld/base/error.h"
#include "gld/base/mapped_file.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <string_view>

#include <libexif/exif-data.h>

namespace gld {
namespace {

using ExifPointer = std::unique_ptr<ExifData, decltype(&exif_data_unref)>;

// Returns an unsigned or rational entry; 0 where there is none or its value is no number.
double exif_number(const ExifData& exif, ExifIfd place, ExifTag tag) {
  const ExifEntry* entry = exif_content_get_entry(exif.ifd[place], tag);
  if (entry == nullptr || entry->components < 1 || entry->size < exif_format_get_size(entry->format))
    return 0;
  const ExifByteOrder order = exif_data_get_byte_order(const_cast<ExifData*>(&exif));
  if (entry->format == EXIF_FORMAT_SHORT) return exif_get_short(entry->data, order);
  if (entry->format == EXIF_FORMAT_LONG) return exif_get_long(entry->data, order);
  if (entry->format != EXIF_FORMAT_RATIONAL) return 0;
  const ExifRational value = exif_get_rational(entry->data, order);
  return value.denominator == 0 ? 0 : static_cast<double>(value.numerator) / value.denominator;
}

// Returns the focal length over the longer side of the picture. FocalLengthIn35mmFilm says what lens has the same angle
// over the diagonal of 36x24 mm; else the focal length in mm and the pixels of the sensor a unit of
// FocalPlaneResolutionUnit (2 inch, 3 cm, 4 mm, 5 um) say it, for the size that EXIF itself names (the picture may be a
// smaller copy, not cut).
double exif_focal_length(const ExifData& exif, const ImageFileInfo& info) {
  const auto width = static_cast<double>(info.width), height = static_cast<double>(info.height);
  const double longer = std::max(width, height);
  if (longer <= 0) return 0;
  double found = exif_number(exif, EXIF_IFD_EXIF, EXIF_TAG_FOCAL_LENGTH_IN_35MM_FILM) *
                 std::hypot(width, height) / longer / std::hypot(36.0, 24.0);
  if (found <= 0) {
    const double focal_length = exif_number(exif, EXIF_IFD_EXIF, EXIF_TAG_FOCAL_LENGTH);  // mm
    const double resolution = exif_number(exif, EXIF_IFD_EXIF, EXIF_TAG_FOCAL_PLANE_X_RESOLUTION);
    const double exif_width = exif_number(exif, EXIF_IFD_EXIF, EXIF_TAG_PIXEL_X_DIMENSION);
    const double exif_height = exif_number(exif, EXIF_IFD_EXIF, EXIF_TAG_PIXEL_Y_DIMENSION);
    const double unit = exif_number(exif, EXIF_IFD_EXIF, EXIF_TAG_FOCAL_PLANE_RESOLUTION_UNIT);
    const double millimetres = unit == 3 ? 10 : unit == 4 ? 1 : unit == 5 ? 0.001 : 25.4;
    // What was cut or turned without its metadata has another aspect.
    const bool whole =
        exif_width > 0 && std::abs(exif_width * height - exif_height * width) <= 0.02 * exif_width * height;
    if (whole) found = focal_length * resolution / millimetres / std::max(exif_width, exif_height);
  }
  // This goes from a fisheye to the longest telescope; a number outside is damage.
  return found > 0.1 && found < 100 ? found : 0;
}

// Adds what EXIF metadata ("Exif", two zeros, a TIFF structure) say of a picture whose size is known; nothing where
// they are damaged: a picture with broken metadata is still a picture. OpenCV would turn the picture and not say so,
// but cameras may belong to the picture as stored.
ImageFileInfo with_exif(ImageFileInfo info, const std::string& metadata) {
  if (metadata.empty()) return info;
  const ExifPointer exif(exif_data_new(), exif_data_unref);
  if (!exif) return info;
  // Otherwise missing entries are made up.
  exif_data_unset_option(exif.get(), EXIF_DATA_OPTION_FOLLOW_SPECIFICATION);
  exif_data_load_data(exif.get(), reinterpret_cast<const unsigned char*>(metadata.data()),
                      static_cast<unsigned int>(metadata.size()));
  const ExifEntry* entry = exif_content_get_entry(exif->ifd[EXIF_IFD_0], EXIF_TAG_ORIENTATION);
  if (entry != nullptr && entry->format == EXIF_FORMAT_SHORT && entry->size >= 2) {
    const ExifShort value = exif_get_short(entry->data, exif_data_get_byte_order(exif.get()));
    if (value >= 1 && value <= 8) info.orientation = value;
  }
  info.focal_length = exif_focal_length(*exif, info);
  return info;
}

ImageFileInfo header_info(std::string_view bytes, const std::string& where) {
  const auto format = image_format(bytes);
  if (!format) {
    fail({where, "a " + image_format_names() + " image", bytes.empty() ? "an empty file" : "something else",
          "convert it"});
  }
  switch (*format) {
    case ImageFormat::kJpeg: {
      const JpegHeader header = read_jpeg_header(bytes, where);
      return with_exif({header.width, header.height, 1, 0}, header.exif);
    }
    case ImageFormat::kWebp: {
      const WebpHeader header = read_webp_header(bytes, where);
      return with_exif({header.width, header.height, 1, 0}, header.exif);
    }
    case ImageFormat::kTiff: {
      const TiffHeader header = read_tiff_header(bytes, where);
      return {header.width, header.height, header.orientation, 0};
    }
    case ImageFormat::kHeif: {
      const HeifHeader header = read_heif_header(bytes, where);
      ImageFileInfo info = with_exif({header.width, header.height, 1, 0}, header.exif);
      info.orientation = 1;  // the file has turned it already
      return info;
    }
    case ImageFormat::kPng:
      break;
  }
  const PngHeader header = read_png_header(bytes, where);
  return with_exif({header.width, header.height, 1, 0}, header.exif);
}

// Says whether the end that every file of its format has is there; more may stand behind it.
bool has_end(std::string_view bytes, const std::string& where) {
  constexpr std::string_view kPngEnd("\0\0\0\0IEND\xAE\x42\x60\x82", 12);
  constexpr std::string_view kJpegEnd("\xFF\xD9", 2);  // in compressed pixels 0xFF is always followed by 0
  const auto end_after = [&](size_t start, std::string_view end) {
    return bytes.substr(start).rfind(end) != std::string_view::npos;
  };
  switch (image_format(bytes).value_or(ImageFormat::kTiff)) {
    case ImageFormat::kPng:
      return end_after(0, kPngEnd);
    case ImageFormat::kJpeg:
      return end_after(read_jpeg_header(bytes, where).pixels, kJpegEnd);
    case ImageFormat::kWebp:
      return read_webp_header(bytes, where).whole;
    case ImageFormat::kTiff:
    case ImageFormat::kHeif:
      break;
  }
  return true;
}

std::string_view text_of(const MappedFile& file) {
  return {reinterpret_cast<const char*>(file.bytes().data), file.bytes().size};
}

}  // namespace

ImageFileInfo probe_image_bytes(std::string_view bytes, const std::string& where) {
  const ImageFileInfo info = header_info(bytes, where);
  if (info.width < 2 || info.height < 2) {
    fail({where, "an image at least 2 pixels wide and high", size_text(info.width, info.height),
          "leave it out"});
  }
  check_picture_size(info.width, info.height, where);
  return info;
}

ImageFileInfo probe_image_file(const std::filesystem::path& file) {
  const auto mapped = MappedFile::open(file);
  return probe_image_bytes(text_of(*mapped), file.string());
}

void check_image_end(const std::filesystem::path& file) {
  const auto mapped = MappedFile::open(file);
  const std::string_view bytes = text_of(*mapped);
  probe_image_bytes(bytes, file.string());
  if (!has_end(bytes, file.string())) fail_short_image(file.string());
}

}  // namespace gld
