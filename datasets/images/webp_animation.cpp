#include "datasets/images/webp_animation.h"

#include "gld/base/error.h"

#include <fmt/format.h>
#include <webp/encode.h>
#include <webp/mux.h>

namespace gld {
namespace {

constexpr int64_t kLargestWebpSide = WEBP_MAX_DIMENSION;

[[noreturn]] void fail_encoder(const std::string& complaint) {
  fail({"WebP animation", "libwebp to encode it",
        complaint.empty() ? "a failure without a reason" : complaint, "check that there is memory for it"});
}

// libwebp's structures, freed whatever happens.
struct Picture {
  WebPPicture value{};
  Picture() {
    if (WebPPictureInit(&value) == 0) fail_encoder("another version of the library");
  }
  ~Picture() { WebPPictureFree(&value); }
  Picture(const Picture&) = delete;
  Picture& operator=(const Picture&) = delete;
};

struct Bytes {
  WebPData value{};
  Bytes() { WebPDataInit(&value); }
  ~Bytes() { WebPDataClear(&value); }
  Bytes(const Bytes&) = delete;
  Bytes& operator=(const Bytes&) = delete;
  std::string text() const { return {reinterpret_cast<const char*>(value.bytes), value.size}; }
};

std::string with_xmp(const Bytes& file, const std::string& xmp) {
  const std::unique_ptr<WebPMux, decltype(&WebPMuxDelete)> mux(WebPMuxCreate(&file.value, 0), WebPMuxDelete);
  if (mux == nullptr) fail_encoder("a file that it cannot read itself");
  const WebPData chunk{reinterpret_cast<const uint8_t*>(xmp.data()), xmp.size()};
  Bytes result;
  if (WebPMuxSetChunk(mux.get(), "XMP ", &chunk, 0) != WEBP_MUX_OK ||
      WebPMuxAssemble(mux.get(), &result.value) != WEBP_MUX_OK) {
    fail_encoder("no place for metadata");
  }
  return result.text();
}

}  // namespace

struct WebpAnimation::Encoder {
  int64_t width = 0;
  int64_t height = 0;
  int64_t last_ms = -1;
  WebPConfig config{};
  std::unique_ptr<WebPAnimEncoder, decltype(&WebPAnimEncoderDelete)> encoder{nullptr, WebPAnimEncoderDelete};
};

WebpAnimation::WebpAnimation(int64_t width, int64_t height, double quality)
    : encoder_(std::make_unique<Encoder>()) {
  if (width < 1 || height < 1 || width > kLargestWebpSide || height > kLargestWebpSide) {
    fail({"WebP animation", fmt::format("sides of 1 to {} pixels", kLargestWebpSide),
          size_text(width, height), "choose another format"});
  }
  encoder_->width = width;
  encoder_->height = height;
  if (WebPConfigInit(&encoder_->config) == 0) fail_encoder("another version of the library");
  encoder_->config.quality = static_cast<float>(quality);
  encoder_->config.use_sharp_yuv = 1;  // edges of colours at half the resolution
  if (WebPValidateConfig(&encoder_->config) == 0) {
    fail({"WebP animation", "a quality from 0 to 100", fmt::format("{}", quality), "choose another"});
  }
  WebPAnimEncoderOptions options;
  if (WebPAnimEncoderOptionsInit(&options) == 0) fail_encoder("another version of the library");
  options.anim_params.loop_count = 0;  // for ever
  encoder_->encoder.reset(WebPAnimEncoderNew(static_cast<int>(width), static_cast<int>(height), &options));
  if (encoder_->encoder == nullptr) fail_encoder("no memory");
}

WebpAnimation::~WebpAnimation() = default;

void WebpAnimation::add(const Image& frame, int64_t from_ms) {
  if (frame.width != encoder_->width || frame.height != encoder_->height) {
    fail({"WebP animation", "frames of one size, " + size_text(encoder_->width, encoder_->height),
          size_text(frame.width, frame.height), "check what made them"});
  }
  if (from_ms <= encoder_->last_ms) {
    fail({"WebP animation", fmt::format("a frame after {} ms", encoder_->last_ms),
          fmt::format("one at {} ms", from_ms), "show each for a millisecond at least"});
  }
  encoder_->last_ms = from_ms;
  Picture picture;
  picture.value.use_argb = 1;
  picture.value.width = static_cast<int>(frame.width);
  picture.value.height = static_cast<int>(frame.height);
  if (WebPPictureImportRGB(&picture.value, frame.rgb.data(), static_cast<int>(3 * frame.width)) == 0)
    fail_encoder("no memory");
  if (WebPAnimEncoderAdd(encoder_->encoder.get(), &picture.value, static_cast<int>(from_ms),
                         &encoder_->config) == 0) {
    fail_encoder(WebPAnimEncoderGetError(encoder_->encoder.get()));
  }
}

std::string WebpAnimation::finish(int64_t end_ms, const std::string& xmp) {
  WebPAnimEncoder* encoder = encoder_->encoder.get();
  Bytes bytes;
  if (WebPAnimEncoderAdd(encoder, nullptr, static_cast<int>(end_ms), nullptr) == 0 ||
      WebPAnimEncoderAssemble(encoder, &bytes.value) == 0) {
    fail_encoder(WebPAnimEncoderGetError(encoder));
  }
  return xmp.empty() ? bytes.text() : with_xmp(bytes, xmp);
}

}  // namespace gld
