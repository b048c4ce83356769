#include "datasets/images/tiff_file.h"

#include "gld/base/error.h"

#include <algorithm>
#include <array>
#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <memory>
#include <vector>

#include <tiffio.h>

namespace gld {
namespace {

constexpr int kMostSamples = 5;  // cyan, magenta, yellow, black and alpha
// What libtiff may take at once to read a directory.
constexpr tmsize_t kDirectoryMemory = 64 << 20;

// The file in memory and what libtiff says about it, instead of printing it.
struct TiffSource {
  std::string_view bytes;
  uint64_t at = 0;
  bool warnings_count = false;  // those about the directory are about tags that nobody reads here
  std::array<char, 200> complaint{};
};

int keep_complaint(TIFF*, void* user, const char*, const char* format, va_list arguments) {
  auto* source = static_cast<TiffSource*>(user);
  // The first one says most.
  if (source->complaint[0] == '\0') {
    std::vsnprintf(source->complaint.data(), source->complaint.size(), format, arguments);
  }
  return 1;  // handled: nothing is printed
}

int keep_warning(TIFF* tiff, void* user, const char* module, const char* format, va_list arguments) {
  if (!static_cast<TiffSource*>(user)->warnings_count) return 1;
  return keep_complaint(tiff, user, module, format, arguments);
}

tmsize_t read_tiff_bytes(thandle_t handle, void* to, tmsize_t count) {
  auto* source = static_cast<TiffSource*>(handle);
  if (source->at >= source->bytes.size() || count <= 0) return 0;
  const auto left = static_cast<tmsize_t>(source->bytes.size() - source->at);
  const tmsize_t taken = std::min(count, left);
  std::memcpy(to, source->bytes.data() + source->at, static_cast<size_t>(taken));
  source->at += static_cast<uint64_t>(taken);
  return taken;
}

tmsize_t write_no_tiff(thandle_t, void*, tmsize_t) { return -1; }

toff_t seek_tiff(thandle_t handle, toff_t offset, int whence) {
  auto* source = static_cast<TiffSource*>(handle);
  if (whence == SEEK_CUR) offset += source->at;
  if (whence == SEEK_END) offset += source->bytes.size();
  source->at = offset;
  return offset;
}

int close_tiff(thandle_t) { return 0; }

toff_t tiff_size(thandle_t handle) { return static_cast<TiffSource*>(handle)->bytes.size(); }

[[noreturn]] void fail_damaged_tiff(const std::string& where, const TiffSource& source) {
  const char* complaint = source.complaint[0] == '\0' ? "no valid file" : source.complaint.data();
  fail({where, "an image that can be decoded", std::string("damaged data (libtiff: ") + complaint + ")",
        "copy or download it again"});
}

struct TiffCloser {
  void operator()(TIFF* tiff) const { TIFFClose(tiff); }
};
using TiffHandle = std::unique_ptr<TIFF, TiffCloser>;

struct TiffOptionsDeleter {
  void operator()(TIFFOpenOptions* options) const { TIFFOpenOptionsFree(options); }
};

TiffHandle open_tiff(TiffSource& source, tmsize_t memory, const std::string& where) {
  const std::unique_ptr<TIFFOpenOptions, TiffOptionsDeleter> options(TIFFOpenOptionsAlloc());
  if (options == nullptr) fail_damaged_tiff(where, source);
  source.at = 0;  // libtiff reads from where it stands
  TIFFOpenOptionsSetErrorHandlerExtR(options.get(), keep_complaint, &source);
  TIFFOpenOptionsSetWarningHandlerExtR(options.get(), keep_warning, &source);
  TIFFOpenOptionsSetMaxSingleMemAlloc(options.get(), memory);
  // With "m" the file is read by the functions below, which check bounds, rather than from mapped memory.
  TiffHandle tiff(TIFFClientOpenExt(where.c_str(), "rm", &source, read_tiff_bytes, write_no_tiff, seek_tiff,
                                    close_tiff, tiff_size, nullptr, nullptr, options.get()));
  if (tiff == nullptr) fail_damaged_tiff(where, source);
  return tiff;
}

TiffHeader header_of(TIFF* tiff, const TiffSource& source, const std::string& where) {
  uint32_t width = 0, height = 0;
  uint16_t orientation = 1;
  if (TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &width) == 0 ||
      TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &height) == 0) {
    fail_damaged_tiff(where, source);
  }
  TIFFGetFieldDefaulted(tiff, TIFFTAG_ORIENTATION, &orientation);
  return {width, height, orientation >= 1 && orientation <= 8 ? orientation : 1};
}

// Returns the bytes of all samples, unpacked; throws Error where the file is of a kind that is not read or cannot hold
// so many.
int64_t checked_bytes(TIFF* tiff, const TiffHeader& header, size_t file_bytes, const std::string& where) {
  uint16_t compression = COMPRESSION_NONE, samples = 1, bits = 1, format = SAMPLEFORMAT_UINT;
  TIFFGetFieldDefaulted(tiff, TIFFTAG_COMPRESSION, &compression);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &samples);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &bits);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &format);
  constexpr std::array<uint16_t, 6> kKnown{COMPRESSION_NONE,          COMPRESSION_LZW,
                                           COMPRESSION_ADOBE_DEFLATE, COMPRESSION_DEFLATE,
                                           COMPRESSION_PACKBITS,      COMPRESSION_JPEG};
  if (std::find(kKnown.begin(), kKnown.end(), compression) == kKnown.end()) {
    fail({where, "a TIFF file without compression, or with LZW, deflate, PackBits or JPEG",
          "compression " + std::to_string(compression), "convert it"});
  }
  if (samples < 1 || samples > kMostSamples) {
    fail({where, "1 to 5 channels", std::to_string(samples), "convert it"});
  }
  if (bits > 16 || (format != SAMPLEFORMAT_UINT && format != SAMPLEFORMAT_VOID)) {
    fail({where, "8 or 16 bits a channel", "another pixel type", "convert it"});
  }
  const int64_t pixels = header.width * header.height;
  const int64_t unpacked = pixels * samples * bits / 8;
  check_picture_size(header.width, header.height, where);
  if (compression != COMPRESSION_NONE) {
    check_compressed_picture_size(header.width, header.height, file_bytes, where);
  } else if (unpacked / 4 > static_cast<int64_t>(file_bytes)) {  // colours may be stored for 2x2 pixels
    fail_short_image(where);
  }
  return unpacked;
}

// Which page is meant cannot be known; a smaller copy of the first, as cameras write, is no page of its own.
void require_one_page(std::string_view bytes, const std::string& where) {
  TiffSource source;
  source.bytes = bytes;
  const TiffHandle tiff = open_tiff(source, kDirectoryMemory, where);
  while (TIFFReadDirectory(tiff.get()) != 0) {
    uint32_t kind = 0;
    TIFFGetFieldDefaulted(tiff.get(), TIFFTAG_SUBFILETYPE, &kind);
    if ((kind & FILETYPE_REDUCEDIMAGE) != 0) continue;
    fail({where, "a TIFF file of one page", "several", "save the page as a file of its own"});
  }
}

// What the channel behind the colours is in libtiff's packed pixels.
enum class TiffAlpha { kNone, kMultiplied, kNotMultiplied };

// A file may have a channel that it says nothing about, near infrared for instance, which libtiff takes for alpha. It
// multiplies colours with their alpha where the file has not, but not greys.
TiffAlpha alpha_of(TIFF* tiff) {
  uint16_t count = 0, photometric = PHOTOMETRIC_RGB;
  uint16_t* kinds = nullptr;
  if (TIFFGetField(tiff, TIFFTAG_EXTRASAMPLES, &count, &kinds) == 0 || count == 0) return TiffAlpha::kNone;
  if (kinds[0] != EXTRASAMPLE_ASSOCALPHA && kinds[0] != EXTRASAMPLE_UNASSALPHA) return TiffAlpha::kNone;
  TIFFGetFieldDefaulted(tiff, TIFFTAG_PHOTOMETRIC, &photometric);
  const bool grey = photometric == PHOTOMETRIC_MINISBLACK || photometric == PHOTOMETRIC_MINISWHITE;
  return grey && kinds[0] == EXTRASAMPLE_UNASSALPHA ? TiffAlpha::kNotMultiplied : TiffAlpha::kMultiplied;
}

std::vector<uint8_t> bgr_over_white(const std::vector<uint32_t>& packed, TiffAlpha alpha) {
  std::vector<uint8_t> bytes;
  bytes.reserve(3 * packed.size());
  for (const uint32_t pixel : packed) {
    const uint32_t opacity = alpha == TiffAlpha::kNone ? 255 : TIFFGetA(pixel);
    for (const uint32_t colour : {TIFFGetB(pixel), TIFFGetG(pixel), TIFFGetR(pixel)}) {
      const uint32_t visible = alpha == TiffAlpha::kNotMultiplied ? (colour * opacity + 127) / 255 : colour;
      bytes.push_back(static_cast<uint8_t>(std::min(255U, visible + 255 - opacity)));
    }
  }
  return bytes;
}

// An image of libtiff's, ended with it.
struct TiffImage {
  TIFFRGBAImage image{};
  bool begun = false;

  TiffImage() = default;
  ~TiffImage() {
    if (begun) TIFFRGBAImageEnd(&image);
  }
  TiffImage(const TiffImage&) = delete;
  TiffImage& operator=(const TiffImage&) = delete;
};

}  // namespace

TiffHeader read_tiff_header(std::string_view bytes, const std::string& where) {
  TiffSource source;
  source.bytes = bytes;
  const TiffHandle tiff = open_tiff(source, kDirectoryMemory, where);
  return header_of(tiff.get(), source, where);
}

DecodedPixels decode_tiff(std::string_view bytes, const std::string& where) {
  TiffSource source;
  source.bytes = bytes;
  TiffHandle tiff = open_tiff(source, kDirectoryMemory, where);
  const TiffHeader header = header_of(tiff.get(), source, where);
  const int64_t unpacked = checked_bytes(tiff.get(), header, bytes.size(), where);
  tiff = open_tiff(source, kDirectoryMemory + 2 * unpacked, where);
  // One way to read all kinds, to 8 bits; a whole photograph is worth more than the 16 bits of some.
  TiffImage opened;
  std::array<char, 1024> reason{};
  if (TIFFRGBAImageOK(tiff.get(), reason.data()) == 0 ||
      TIFFRGBAImageBegin(&opened.image, tiff.get(), 1, reason.data()) == 0) {
    fail({where, "an image that can be decoded", std::string("another kind (libtiff: ") + reason.data() + ")",
          "convert it"});
  }
  opened.begun = true;
  require_one_page(bytes, where);
  opened.image.req_orientation = opened.image.orientation;  // as stored: not turned
  source.warnings_count = true;
  std::vector<uint32_t> raster(static_cast<size_t>(header.width * header.height));
  const int read = TIFFRGBAImageGet(&opened.image, raster.data(), opened.image.width, opened.image.height);
  if (read == 0 || source.complaint[0] != '\0') fail_damaged_tiff(where, source);
  DecodedPixels pixels;
  pixels.width = header.width;
  pixels.height = header.height;
  pixels.channels = 3;
  pixels.bytes = bgr_over_white(raster, alpha_of(tiff.get()));
  return pixels;
}

}  // namespace gld
