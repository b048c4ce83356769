#include "datasets/images/png_file.h"

#include "gld/base/error.h"

#include <algorithm>
#include <array>
#include <csetjmp>
#include <cstring>
#include <utility>

#include <png.h>

namespace gld {
namespace {

// Keeps what libpng has to say, which it would print.
struct Complaint {
  std::array<char, 200> text{};
};

void keep(png_structp png, png_const_charp message) {
  auto* complaint = static_cast<Complaint*>(png_get_error_ptr(png));
  std::strncpy(complaint->text.data(), message, complaint->text.size() - 1);
}

// libpng leaves a function by longjmp(), which runs no destructors: the functions below that call setjmp() own nothing.
[[noreturn]] void on_error(png_structp png, png_const_charp message) {
  keep(png, message);
  png_longjmp(png, 1);
}

void on_reading_warning(png_structp, png_const_charp) {}

// A PNG of this program must not be repaired by leaving something out.
[[noreturn]] void on_writing_warning(png_structp png, png_const_charp message) { on_error(png, message); }

struct Writer {
  Complaint complaint;
  png_structp png = nullptr;
  png_infop info = nullptr;

  Writer() : png(png_create_write_struct(PNG_LIBPNG_VER_STRING, &complaint, on_error, on_writing_warning)) {
    if (png != nullptr) info = png_create_info_struct(png);
  }
  ~Writer() { png_destroy_write_struct(&png, &info); }
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;
};

struct Reader {
  Complaint complaint;
  png_structp png = nullptr;
  png_infop info = nullptr;

  Reader() : png(png_create_read_struct(PNG_LIBPNG_VER_STRING, &complaint, on_error, on_reading_warning)) {
    if (png != nullptr) info = png_create_info_struct(png);
  }
  ~Reader() { png_destroy_read_struct(&png, &info, nullptr); }
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
};

struct Raster {
  int64_t width = 0;
  int64_t height = 0;
  int bits = 8;
  int colour_type = PNG_COLOR_TYPE_RGB;
  std::vector<png_bytep> rows;  // libpng does not write to them
};

void append(png_structp png, png_bytep data, size_t count) {
  try {
    static_cast<std::string*>(png_get_io_ptr(png))->append(reinterpret_cast<const char*>(data), count);
    return;
  } catch (const std::exception&) {
  }
  png_error(png, "no memory for the file");
}

void flush_nothing(png_structp) {}

// Says whether libpng wrote the picture; otherwise the writer's complaint says why not.
bool write(Writer& writer, const Raster& raster, std::vector<png_text>& texts, std::string& bytes) {
  if (writer.info == nullptr) return false;
  if (setjmp(png_jmpbuf(writer.png)) != 0) return false;
  png_set_write_fn(writer.png, &bytes, append, flush_nothing);
  png_set_compression_level(writer.png, 6);
  png_set_IHDR(writer.png, writer.info, static_cast<png_uint_32>(raster.width),
               static_cast<png_uint_32>(raster.height), raster.bits, raster.colour_type, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  if (!texts.empty()) png_set_text(writer.png, writer.info, texts.data(), static_cast<int>(texts.size()));
  png_write_info(writer.png, writer.info);
  if (raster.bits == 16) png_set_swap(writer.png);  // our values are little-endian, the file's big-endian
  png_write_image(writer.png, const_cast<png_bytepp>(raster.rows.data()));
  png_write_end(writer.png, nullptr);
  return true;
}

bool is_ascii(const std::string& text) {
  return std::all_of(text.begin(), text.end(), [](char c) { return (c >= 32 && c < 127) || c == '\n'; });
}

// The chunk points into name and text.
png_text text_chunk(const std::string& name, const std::string& text) {
  if (name.empty() || name.size() > PNG_KEYWORD_MAX_LENGTH || !is_ascii(name)) {
    fail({"PNG text", "a name of 1 to 79 ASCII characters", "\"" + name + "\"", "shorten it"});
  }
  if (text.find('\0') != std::string::npos) {
    fail({"PNG text " + name, "a text without zero bytes", "one", "leave them out"});
  }
  png_text chunk{};
  chunk.compression = is_ascii(text) ? PNG_TEXT_COMPRESSION_NONE : PNG_ITXT_COMPRESSION_NONE;
  chunk.key = const_cast<png_charp>(name.c_str());
  chunk.text = const_cast<png_charp>(text.c_str());
  chunk.text_length = text.size();
  static char no_language[] = "";
  chunk.lang = no_language;
  chunk.lang_key = no_language;
  return chunk;
}

std::string encode(const Raster& raster, const TextItems& texts) {
  std::vector<png_text> chunks;
  chunks.reserve(texts.size());
  for (const auto& [name, text] : texts) chunks.push_back(text_chunk(name, text));
  std::string bytes;
  Writer writer;
  if (!write(writer, raster, chunks, bytes)) {
    fail({"PNG", "libpng to encode the image", std::string("\"") + writer.complaint.text.data() + "\"", ""});
  }
  return bytes;
}

template <class Value>
Raster raster_of(int64_t width, int64_t height, const std::vector<Value>& values, size_t channels) {
  if (width < 1 || height < 1 ||
      values.size() != static_cast<size_t>(width) * static_cast<size_t>(height) * channels) {
    fail({"PNG", "an image with pixels",
          std::to_string(width) + "x" + std::to_string(height) + " with " + std::to_string(values.size()) +
              " values",
          "check what made it"});
  }
  Raster raster;
  raster.width = width;
  raster.height = height;
  raster.bits = 8 * sizeof(Value);
  raster.colour_type = channels == 3 ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_GRAY;
  for (int64_t y = 0; y < height; ++y) {
    const Value* row = values.data() + static_cast<size_t>(y * width) * channels;
    raster.rows.push_back(reinterpret_cast<png_bytep>(const_cast<Value*>(row)));
  }
  return raster;
}

// Bytes in memory that libpng reads.
struct Source {
  std::string_view bytes;
  size_t at = 0;
  bool ended_early = false;
};

void take(png_structp png, png_bytep data, size_t count) {
  auto* source = static_cast<Source*>(png_get_io_ptr(png));
  if (count > source->bytes.size() - source->at) {
    source->ended_early = true;
    png_error(png, "early end");
  }
  std::memcpy(data, source->bytes.data() + source->at, count);
  source->at += count;
}

// Says whether each chunk up to the first of type `last` ends within the file. libpng only warns of a longer one, and
// makes room for what the chunk says before it reads.
bool holds_chunks_until(std::string_view last, std::string_view bytes) {
  constexpr size_t kSignature = 8, kLengthAndType = 8, kChecksum = 4;
  for (size_t at = kSignature; at + kLengthAndType <= bytes.size();) {
    if (bytes.substr(at + 4, 4) == last) break;
    const size_t length =
        png_get_uint_32(const_cast<png_bytep>(reinterpret_cast<const png_byte*>(bytes.data() + at)));
    at += kLengthAndType;
    if (length + kChecksum > bytes.size() - at) return false;
    at += length + kChecksum;
  }
  return true;
}

// Says whether all that stands before the pixels was read; otherwise the reader's complaint says why not.
bool read_info(Reader& reader, Source& source) {
  if (reader.info == nullptr) return false;
  if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
  png_set_read_fn(reader.png, &source, take);
  // What is compressed may not grow beyond the file either.
  png_set_chunk_malloc_max(reader.png, source.bytes.size());
  // A transparency that is left out for its checksum gives other pixels: no chunk may be damaged.
  png_set_crc_action(reader.png, PNG_CRC_ERROR_QUIT, PNG_CRC_ERROR_QUIT);
  png_read_info(reader.png, reader.info);
  return true;
}

[[noreturn]] void fail_damaged_png(const std::string& where, const Source& source, const Reader& reader) {
  if (source.ended_early) fail_short_image(where);
  fail({where, "an image that can be decoded",
        std::string("damaged data (libpng: ") + reader.complaint.text.data() + ")",
        "copy or download it again"});
}

// Says whether the header was read and the form of the rows chosen; otherwise the reader's complaint says why not.
bool start_pixels(Reader& reader, Source& source) {
  if (!read_info(reader, source)) return false;
  if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
  png_set_expand(reader.png);  // palettes, grey of few bits, transparency as a channel
  const int colour = png_get_color_type(reader.png, reader.info);
  const bool transparent =
      (colour & PNG_COLOR_MASK_ALPHA) != 0 || png_get_valid(reader.png, reader.info, PNG_INFO_tRNS) != 0;
  if ((colour & PNG_COLOR_MASK_COLOR) == 0 && transparent) png_set_gray_to_rgb(reader.png);
  png_set_bgr(reader.png);
  if (png_get_bit_depth(reader.png, reader.info) == 16) png_set_swap(reader.png);
  png_set_interlace_handling(reader.png);
  png_read_update_info(reader.png, reader.info);
  return true;
}

bool read_pixels(Reader& reader, png_bytepp rows) {
  if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
  png_read_image(reader.png, rows);
  png_read_end(reader.png, nullptr);
  return true;
}

}  // namespace

PngHeader read_png_header(std::string_view bytes, const std::string& where) {
  if (!holds_chunks_until("IDAT", bytes)) fail_short_image(where);
  Source source{bytes};
  Reader reader;
  if (!read_info(reader, source)) fail_damaged_png(where, source, reader);
  PngHeader header;
  header.width = png_get_image_width(reader.png, reader.info);
  header.height = png_get_image_height(reader.png, reader.info);
  png_uint_32 size = 0;
  png_bytep exif = nullptr;
  if (png_get_eXIf_1(reader.png, reader.info, &size, &exif) != 0) {
    header.exif = std::string(kExifStart) + std::string(reinterpret_cast<const char*>(exif), size);
  }
  png_textp texts = nullptr;
  const int count = png_get_text(reader.png, reader.info, &texts, nullptr);
  for (int i = 0; i < count; ++i) {
    // Of iTXt the first length is that of the other encodings, and 0.
    const size_t length = std::max(texts[i].text_length, texts[i].itxt_length);
    header.texts.emplace_back(texts[i].key, std::string(texts[i].text, length));
  }
  return header;
}

DecodedPixels decode_png(const std::string& bytes, const std::string& where) {
  if (!holds_chunks_until("IEND", bytes)) fail_short_image(where);
  Source source{bytes};
  Reader reader;
  if (!start_pixels(reader, source)) fail_damaged_png(where, source, reader);
  DecodedPixels pixels;
  pixels.width = png_get_image_width(reader.png, reader.info);
  pixels.height = png_get_image_height(reader.png, reader.info);
  pixels.channels = png_get_channels(reader.png, reader.info);
  pixels.bits = png_get_bit_depth(reader.png, reader.info);
  check_picture_size(pixels.width, pixels.height, where);
  const size_t stride = png_get_rowbytes(reader.png, reader.info);
  pixels.bytes.resize(stride * static_cast<size_t>(pixels.height));
  std::vector<png_bytep> rows;
  for (int64_t y = 0; y < pixels.height; ++y)
    rows.push_back(pixels.bytes.data() + static_cast<size_t>(y) * stride);
  if (!read_pixels(reader, rows.data())) fail_damaged_png(where, source, reader);
  return pixels;
}

std::string encode_png(const Image& image, const TextItems& texts) {
  return encode(raster_of(image.width, image.height, image.rgb, 3), texts);
}

std::string encode_png(const Grey16& image, const TextItems& texts) {
  return encode(raster_of(image.width, image.height, image.values, 1), texts);
}

}  // namespace gld
