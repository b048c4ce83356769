#include "datasets/images/webp_file.h"

#include "gld/base/error.h"

#include <cstddef>
#include <memory>

#include <webp/decode.h>
#include <webp/demux.h>

namespace gld {
namespace {

using Demuxer = std::unique_ptr<WebPDemuxer, decltype(&WebPDemuxDelete)>;

struct OpenedWebp {
  Demuxer demuxer{nullptr, WebPDemuxDelete};
  WebPDemuxState state = WEBP_DEMUX_PARSE_ERROR;

  uint32_t feature(WebPFormatFeature name) const { return WebPDemuxGetI(demuxer.get(), name); }
};

[[noreturn]] void fail_damaged_webp(const std::string& where, const std::string& complaint) {
  fail({where, "an image that can be decoded", "damaged data (libwebp: " + complaint + ")",
        "copy or download it again"});
}

OpenedWebp open_webp(std::string_view bytes, const std::string& where) {
  const WebPData data{reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()};
  OpenedWebp opened;
  opened.demuxer.reset(WebPDemuxPartial(&data, &opened.state));
  if (opened.state == WEBP_DEMUX_PARSE_ERROR) fail_damaged_webp(where, "no valid file");
  if (opened.demuxer == nullptr || opened.state == WEBP_DEMUX_PARSING_HEADER) fail_short_image(where);
  return opened;
}

std::string exif_of(const OpenedWebp& opened) {
  WebPChunkIterator chunk;
  std::string exif;
  if (WebPDemuxGetChunk(opened.demuxer.get(), "EXIF", 1, &chunk) != 0) {
    exif.assign(reinterpret_cast<const char*>(chunk.chunk.bytes), chunk.chunk.size);
    // Some writers put what a JPEG file has before it.
    if (exif.compare(0, kExifStart.size(), kExifStart) != 0) exif.insert(0, kExifStart);
  }
  WebPDemuxReleaseChunkIterator(&chunk);
  return exif;
}

const char* status_text(VP8StatusCode status) {
  switch (status) {
    case VP8_STATUS_OUT_OF_MEMORY:
      return "no memory for its pixels";
    case VP8_STATUS_UNSUPPORTED_FEATURE:
      return "a feature that it does not know";
    case VP8_STATUS_SUSPENDED:
    case VP8_STATUS_NOT_ENOUGH_DATA:
      return "too little data";
    default:
      return "a wrong stream of bits";
  }
}

// Returns the bytes of the one picture.
std::string_view picture_of(const OpenedWebp& opened, const std::string& where) {
  const uint32_t frames = opened.feature(WEBP_FF_FRAME_COUNT);
  if (frames != 1) {
    fail({where, "one picture", "an animation of " + std::to_string(frames), "save its frames as files"});
  }
  WebPIterator frame;
  const bool found = WebPDemuxGetFrame(opened.demuxer.get(), 1, &frame) != 0;
  const std::string_view bytes(reinterpret_cast<const char*>(frame.fragment.bytes), frame.fragment.size);
  const bool covers = found && frame.complete != 0 && frame.x_offset == 0 && frame.y_offset == 0 &&
                      static_cast<uint32_t>(frame.width) == opened.feature(WEBP_FF_CANVAS_WIDTH) &&
                      static_cast<uint32_t>(frame.height) == opened.feature(WEBP_FF_CANVAS_HEIGHT);
  WebPDemuxReleaseIterator(&frame);  // the bytes are the file's
  if (!covers) fail_damaged_webp(where, "a frame of another size");
  return bytes;
}

}  // namespace

WebpHeader read_webp_header(std::string_view bytes, const std::string& where) {
  const OpenedWebp opened = open_webp(bytes, where);
  WebpHeader header;
  header.width = opened.feature(WEBP_FF_CANVAS_WIDTH);
  header.height = opened.feature(WEBP_FF_CANVAS_HEIGHT);
  header.whole = opened.state == WEBP_DEMUX_DONE;
  const bool has_exif = (opened.feature(WEBP_FF_FORMAT_FLAGS) & EXIF_FLAG) != 0;
  if (has_exif && !header.whole) fail_short_image(where);
  if (has_exif) header.exif = exif_of(opened);
  return header;
}

DecodedPixels decode_webp(std::string_view bytes, const std::string& where) {
  const OpenedWebp opened = open_webp(bytes, where);
  if (opened.state != WEBP_DEMUX_DONE) fail_short_image(where);
  const std::string_view picture = picture_of(opened, where);
  WebPDecoderConfig config;
  if (WebPInitDecoderConfig(&config) == 0) fail_damaged_webp(where, "another version of the library");
  const auto* data = reinterpret_cast<const uint8_t*>(picture.data());
  const VP8StatusCode known = WebPGetFeatures(data, picture.size(), &config.input);
  if (known != VP8_STATUS_OK) fail_damaged_webp(where, status_text(known));
  DecodedPixels pixels;
  pixels.width = config.input.width;
  pixels.height = config.input.height;
  pixels.channels = config.input.has_alpha != 0 ? 4 : 3;
  check_compressed_picture_size(pixels.width, pixels.height, bytes.size(), where);
  const int64_t stride = pixels.width * pixels.channels;
  pixels.bytes.resize(static_cast<size_t>(stride * pixels.height));
  config.output.colorspace = pixels.channels == 4 ? MODE_BGRA : MODE_BGR;
  config.output.is_external_memory = 1;
  config.output.u.RGBA.rgba = pixels.bytes.data();
  config.output.u.RGBA.stride = static_cast<int>(stride);
  config.output.u.RGBA.size = pixels.bytes.size();
  const VP8StatusCode status = WebPDecode(data, picture.size(), &config);
  WebPFreeDecBuffer(&config.output);
  if (status != VP8_STATUS_OK) fail_damaged_webp(where, status_text(status));
  return pixels;
}

}  // namespace gld
