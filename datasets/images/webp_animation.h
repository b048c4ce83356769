#pragma once

#include "datasets/images/image.h"

#include <cstdint>
#include <memory>
#include <string>

namespace gld {

// A moving picture as a WebP file that goes on from the beginning for ever, lossy (the colours at half the resolution,
// as the format has them) by libwebp's animation encoder.
class WebpAnimation {
 public:
  // Sides are in pixels, from 1 to 16383; quality is from 0 to 100. Throws Error.
  WebpAnimation(int64_t width, int64_t height, double quality);
  ~WebpAnimation();
  WebpAnimation(const WebpAnimation&) = delete;
  WebpAnimation& operator=(const WebpAnimation&) = delete;

  // Adds a frame that is shown from that time on, in milliseconds from the beginning, later than the frame before.
  // Throws Error for another size, and where libwebp fails.
  void add(const Image& frame, int64_t from_ms);
  // Returns the file's bytes, the last frame shown until then. xmp is metadata in XML for the file's XMP chunk, or
  // empty. Nothing may be added afterwards. Equal frames and texts give equal bytes.
  std::string finish(int64_t end_ms, const std::string& xmp);

 private:
  struct Encoder;
  std::unique_ptr<Encoder> encoder_;
};

}  // namespace gld
