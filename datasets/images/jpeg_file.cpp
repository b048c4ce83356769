#include "datasets/images/jpeg_file.h"

#include "gld/base/error.h"

#include <array>
#include <csetjmp>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <new>

#include <jpeglib.h>
// jpeglib.h does not include what jerror.h needs.
#include <jerror.h>

namespace gld {
namespace {

// A progressive file of few bytes may ask for thousands of passes over all pixels.
constexpr int kMostScans = 200;

constexpr int kExifMarker = JPEG_APP0 + 1;  // other metadata have it too
constexpr unsigned int kLongestMarker = 0xFFFF;

// libjpeg leaves a function by longjmp(), which runs no destructors: read_header() and read_rows() own nothing.
struct JpegErrors {
  jpeg_error_mgr manager{};  // first, so that libjpeg's pointer to it is one to this
  std::jmp_buf leave{};
  std::array<char, JMSG_LENGTH_MAX> text{};
};

JpegErrors& errors_of(j_common_ptr info) { return *reinterpret_cast<JpegErrors*>(info->err); }

[[noreturn]] void leave_jpeg(j_common_ptr info) {
  info->err->format_message(info, errors_of(info).text.data());
  std::longjmp(errors_of(info).leave, 1);
}

// Some complaints are about what lies beside the pixels. Every other one means that blocks were made up.
bool is_harmless(int code) {
  return code == JWRN_ADOBE_XFORM || code == JWRN_JFIF_MAJOR || code == JWRN_BOGUS_ICC;
}

void on_jpeg_message(j_common_ptr info, int level) {
  if (level < 0 && !is_harmless(info->err->msg_code)) leave_jpeg(info);
}

void print_nothing(j_common_ptr) {}

void stop_endless_scans(j_common_ptr info) {
  if (!info->is_decompressor) return;
  if (reinterpret_cast<j_decompress_ptr>(info)->input_scan_number <= kMostScans) return;
  std::strncpy(errors_of(info).text.data(), "more than 200 scans", JMSG_LENGTH_MAX - 1);
  std::longjmp(errors_of(info).leave, 1);
}

struct JpegReader {
  JpegErrors errors;
  jpeg_progress_mgr progress{};
  jpeg_decompress_struct info{};

  JpegReader() {
    info.err = jpeg_std_error(&errors.manager);
    errors.manager.error_exit = leave_jpeg;
    errors.manager.emit_message = on_jpeg_message;
    errors.manager.output_message = print_nothing;
    progress.progress_monitor = stop_endless_scans;
  }
  ~JpegReader() { jpeg_destroy_decompress(&info); }
  JpegReader(const JpegReader&) = delete;
  JpegReader& operator=(const JpegReader&) = delete;
};

struct JpegWriter {
  JpegErrors errors;
  jpeg_compress_struct info{};
  unsigned char* bytes = nullptr;  // of malloc(), as libjpeg asks for them
  unsigned long size = 0;

  JpegWriter() {
    info.err = jpeg_std_error(&errors.manager);
    errors.manager.error_exit = leave_jpeg;
    errors.manager.output_message = print_nothing;
  }
  ~JpegWriter() {
    jpeg_destroy_compress(&info);
    std::free(bytes);
  }
  JpegWriter(const JpegWriter&) = delete;
  JpegWriter& operator=(const JpegWriter&) = delete;
};

// Says whether all was written; otherwise the errors' text says why not.
bool write_rows(JpegWriter& writer, const Image& image, int quality) {
  if (setjmp(writer.errors.leave) != 0) return false;
  jpeg_create_compress(&writer.info);
  jpeg_mem_dest(&writer.info, &writer.bytes, &writer.size);
  writer.info.image_width = static_cast<JDIMENSION>(image.width);
  writer.info.image_height = static_cast<JDIMENSION>(image.height);
  writer.info.input_components = 3;
  writer.info.in_color_space = JCS_RGB;
  jpeg_set_defaults(&writer.info);
  jpeg_set_quality(&writer.info, quality, TRUE);
  jpeg_start_compress(&writer.info, TRUE);
  while (writer.info.next_scanline < writer.info.image_height) {
    JSAMPROW row = const_cast<JSAMPROW>(image.pixel(0, writer.info.next_scanline));
    jpeg_write_scanlines(&writer.info, &row, 1);
  }
  jpeg_finish_compress(&writer.info);
  return true;
}

// Says whether the header was read and the output chosen; otherwise the errors' text says why not.
bool read_header(JpegReader& reader, std::string_view bytes) {
  if (setjmp(reader.errors.leave) != 0) return false;
  jpeg_create_decompress(&reader.info);
  reader.info.progress = &reader.progress;
  jpeg_mem_src(&reader.info, reinterpret_cast<const unsigned char*>(bytes.data()),
               static_cast<unsigned long>(bytes.size()));
  jpeg_save_markers(&reader.info, kExifMarker, kLongestMarker);
  jpeg_read_header(&reader.info, TRUE);
  if (reader.info.num_components == 4) {
    reader.info.out_color_space = JCS_CMYK;
  } else if (reader.info.num_components != 1) {
    reader.info.out_color_space = JCS_EXT_BGR;
  }
  jpeg_calc_output_dimensions(&reader.info);
  return true;
}

bool read_rows(JpegReader& reader, uint8_t* rows) {
  if (setjmp(reader.errors.leave) != 0) return false;
  jpeg_start_decompress(&reader.info);
  const size_t stride =
      static_cast<size_t>(reader.info.output_width) * static_cast<size_t>(reader.info.output_components);
  while (reader.info.output_scanline < reader.info.output_height) {
    JSAMPROW row = rows + reader.info.output_scanline * stride;
    jpeg_read_scanlines(&reader.info, &row, 1);
  }
  // This reads up to the end marker: bytes that no block used are a complaint.
  jpeg_finish_decompress(&reader.info);
  return true;
}

// Makes the colours that ink, stored inverted, gives on white paper.
void bgr_from_cmyk(DecodedPixels& pixels) {
  const size_t count = pixels.bytes.size() / 4;
  for (size_t i = 0; i < count; ++i) {
    const uint8_t* ink = pixels.bytes.data() + 4 * i;
    const int key = ink[3];
    const int cyan = key - ((255 - ink[0]) * key >> 8), magenta = key - ((255 - ink[1]) * key >> 8),
              yellow = key - ((255 - ink[2]) * key >> 8);
    uint8_t* pixel = pixels.bytes.data() + 3 * i;  // never behind what is still to be read
    pixel[0] = static_cast<uint8_t>(yellow);
    pixel[1] = static_cast<uint8_t>(magenta);
    pixel[2] = static_cast<uint8_t>(cyan);
  }
  pixels.bytes.resize(3 * count);
  pixels.channels = 3;
}

[[noreturn]] void fail_jpeg(const JpegReader& reader, const std::string& where) {
  const int code = reader.errors.manager.msg_code;
  if (code == JWRN_JPEG_EOF || code == JERR_INPUT_EMPTY) fail_short_image(where);
  fail({where, "an image that can be decoded",
        std::string("damaged data (libjpeg: ") + reader.errors.text.data() + ")",
        "copy or download it again"});
}

}  // namespace

JpegHeader read_jpeg_header(std::string_view bytes, const std::string& where) {
  JpegReader reader;
  if (!read_header(reader, bytes)) fail_jpeg(reader, where);
  JpegHeader header;
  header.width = reader.info.image_width;
  header.height = reader.info.image_height;
  header.pixels = bytes.size() - reader.info.src->bytes_in_buffer;
  for (const jpeg_marker_struct* marker = reader.info.marker_list; marker != nullptr; marker = marker->next) {
    const std::string_view data(reinterpret_cast<const char*>(marker->data), marker->data_length);
    if (data.substr(0, kExifStart.size()) != kExifStart) continue;
    header.exif = data;
    break;
  }
  return header;
}

DecodedPixels decode_jpeg(const std::string& bytes, const std::string& where) {
  JpegReader reader;
  if (!read_header(reader, bytes)) fail_jpeg(reader, where);
  DecodedPixels pixels;
  pixels.width = reader.info.output_width;
  pixels.height = reader.info.output_height;
  pixels.channels = reader.info.out_color_components;
  check_picture_size(pixels.width, pixels.height, where);
  if (pixels.channels != 1 && pixels.channels != 3 && pixels.channels != 4) {
    fail({where, "1, 3 or 4 channels", std::to_string(pixels.channels), "convert it"});
  }
  pixels.bytes.resize(static_cast<size_t>(pixels.width * pixels.height * pixels.channels));
  if (!read_rows(reader, pixels.bytes.data())) fail_jpeg(reader, where);
  if (pixels.channels == 4) bgr_from_cmyk(pixels);
  return pixels;
}

std::string encode_jpeg(const Image& image, int quality, const std::string& where) {
  if (image.empty() || static_cast<int64_t>(image.rgb.size()) != 3 * image.width * image.height) {
    fail({where, "an image with 3 bytes a pixel", std::to_string(image.rgb.size()) + " bytes", {}});
  }
  JpegWriter writer;
  if (!write_rows(writer, image, quality)) {
    fail({where, "an image that JPEG can hold", std::string("libjpeg's answer: ") + writer.errors.text.data(),
          "write it as PNG"});
  }
  return {reinterpret_cast<const char*>(writer.bytes), writer.size};
}

}  // namespace gld
