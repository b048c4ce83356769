#pragma once

#include "datasets/images/image.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <webp/demux.h>

namespace gld::test {

// What a WebP animation shows.
struct WebpFrames {
  std::vector<Image> frames;
  std::vector<int> ends_ms;  // when each makes place for the next one
  int loops = -1;            // 0: for ever
  std::string xmp;
};

inline WebpFrames webp_frames(const std::string& bytes) {
  WebpFrames result;
  const WebPData data{reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()};
  WebPAnimDecoderOptions options;
  EXPECT_NE(WebPAnimDecoderOptionsInit(&options), 0);
  WebPAnimDecoder* decoder = WebPAnimDecoderNew(&data, &options);
  EXPECT_NE(decoder, nullptr);
  if (decoder == nullptr) return result;
  WebPAnimInfo info{};
  WebPAnimDecoderGetInfo(decoder, &info);
  result.loops = static_cast<int>(info.loop_count);
  while (WebPAnimDecoderHasMoreFrames(decoder) != 0) {
    uint8_t* rgba = nullptr;
    int end = 0;
    if (WebPAnimDecoderGetNext(decoder, &rgba, &end) == 0) break;
    Image image(info.canvas_width, info.canvas_height);
    for (size_t i = 0; i < image.rgb.size() / 3; ++i)
      std::copy(rgba + 4 * i, rgba + 4 * i + 3, image.rgb.begin() + static_cast<std::ptrdiff_t>(3 * i));
    result.frames.push_back(image);
    result.ends_ms.push_back(end);
  }
  WebPChunkIterator chunk;
  if (WebPDemuxGetChunk(WebPAnimDecoderGetDemuxer(decoder), "XMP ", 1, &chunk) != 0)
    result.xmp.assign(reinterpret_cast<const char*>(chunk.chunk.bytes), chunk.chunk.size);
  WebPDemuxReleaseChunkIterator(&chunk);
  WebPAnimDecoderDelete(decoder);
  return result;
}

// Of all three colours, in dB.
inline double psnr_of(const Image& a, const Image& b) {
  if (a.rgb.size() != b.rgb.size() || a.rgb.empty()) return 0;
  double sum = 0;
  for (size_t i = 0; i < a.rgb.size(); ++i) sum += (a.rgb[i] - b.rgb[i]) * (a.rgb[i] - b.rgb[i]);
  if (sum == 0) return std::numeric_limits<double>::infinity();
  return 10 * std::log10(255.0 * 255 * static_cast<double>(a.rgb.size()) / sum);
}

// Returns a pixel's brightness (BT.601), which films keep at full resolution; colour they keep at half of it.
inline double brightness_of(const uint8_t* rgb) { return 0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2]; }

// Of brightness, in dB.
inline double brightness_psnr_of(const Image& a, const Image& b) {
  if (a.rgb.size() != b.rgb.size() || a.rgb.empty()) return 0;
  double sum = 0;
  for (size_t i = 0; i < a.rgb.size(); i += 3) {
    const double off = brightness_of(a.rgb.data() + i) - brightness_of(b.rgb.data() + i);
    sum += off * off;
  }
  if (sum == 0) return std::numeric_limits<double>::infinity();
  return 10 * std::log10(255.0 * 255 * static_cast<double>(a.rgb.size()) / 3 / sum);
}

}  // namespace gld::test
