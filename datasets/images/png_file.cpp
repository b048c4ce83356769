#include "datasets/images/png_file.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <zlib.h>

namespace gld {
namespace {

constexpr size_t kSignatureBytes = 8;
constexpr size_t kHeaderEnd = kSignatureBytes + 25;  // the IHDR chunk is always 25 bytes
const char* const kSignature = "\x89PNG\r\n\x1a\n";

std::string big_endian(uint32_t value) {
  std::string bytes(4, '\0');
  for (int i = 0; i < 4; ++i) bytes[i] = static_cast<char>((value >> (24 - 8 * i)) & 0xff);
  return bytes;
}

uint32_t read_big_endian(const std::string& bytes, size_t offset) {
  uint32_t value = 0;
  for (size_t i = 0; i < 4; ++i) value = (value << 8) | static_cast<uint8_t>(bytes[offset + i]);
  return value;
}

uint32_t checksum(const std::string& bytes, size_t offset, size_t count) {
  const auto* data = reinterpret_cast<const Bytef*>(bytes.data() + offset);
  return static_cast<uint32_t>(crc32(crc32(0, nullptr, 0), data, static_cast<uInt>(count)));
}

std::string chunk(const std::string& type, const std::string& data) {
  const std::string body = type + data;
  return big_endian(static_cast<uint32_t>(data.size())) + body + big_endian(checksum(body, 0, body.size()));
}

std::string text_chunk(const std::string& name, const std::string& text) {
  const auto ascii = [](char c) { return (c >= 32 && c < 127) || c == '\n'; };
  if (name.empty() || name.size() > 79 || !std::all_of(name.begin(), name.end(), ascii)) {
    fail({"PNG text", "a name of 1 to 79 ASCII characters", "\"" + name + "\"", "shorten it"});
  }
  // Behind the name: end, no compression (2 bytes), no language, no translated name.
  if (std::all_of(text.begin(), text.end(), ascii)) return chunk("tEXt", name + '\0' + text);
  return chunk("iTXt", name + std::string(5, '\0') + text);
}

std::string encoded_png(const cv::Mat& pixels, const TextItems& texts) {
  std::vector<unsigned char> encoded;
  if (!cv::imencode(".png", pixels, encoded, {cv::IMWRITE_PNG_COMPRESSION, 6})) {
    fail({"PNG", "OpenCV to encoded_png the image", "a refusal", "check how OpenCV was built"});
  }
  std::string bytes(encoded.begin(), encoded.begin() + kHeaderEnd);
  for (const auto& [name, text] : texts) bytes += text_chunk(name, text);
  return bytes.append(encoded.begin() + kHeaderEnd, encoded.end());
}

void check_pixels(int64_t width, int64_t height, size_t values, size_t channels) {
  if (width < 1 || height < 1 ||
      values != static_cast<size_t>(width) * static_cast<size_t>(height) * channels) {
    fail(
        {"PNG", "an image with pixels",
         std::to_string(width) + "x" + std::to_string(height) + " with " + std::to_string(values) + " values",
         "check what made it"});
  }
}

}  // namespace

std::string encode_png(const Image& image, const TextItems& texts) {
  check_pixels(image.width, image.height, image.rgb.size(), 3);
  const cv::Mat rgb(static_cast<int>(image.height), static_cast<int>(image.width), CV_8UC3,
                    const_cast<uint8_t*>(image.rgb.data()));
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  return encoded_png(bgr, texts);
}

std::string encode_png(const Grey16& image, const TextItems& texts) {
  check_pixels(image.width, image.height, image.values.size(), 1);
  return encoded_png(cv::Mat(static_cast<int>(image.height), static_cast<int>(image.width), CV_16UC1,
                             const_cast<uint16_t*>(image.values.data())),
                     texts);
}

TextItems read_png_texts(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  if (bytes.compare(0, kSignatureBytes, kSignature) != 0) {
    fail({file.string(), "a PNG file", "another one", "check the path"});
  }
  TextItems texts;
  size_t offset = kSignatureBytes;
  std::string type;
  while (type != "IEND") {
    // Length, type and checksum take 12 bytes.
    const size_t left = bytes.size() - offset;
    const size_t length = left < 12 ? 0 : read_big_endian(bytes, offset);
    if (left < 12 || length > left - 12) {
      fail({file.string(), "a whole PNG file", "one that ends early", "write it again"});
    }
    type = bytes.substr(offset + 4, 4);
    if (checksum(bytes, offset + 4, length + 4) != read_big_endian(bytes, offset + 8 + length)) {
      fail({file.string(), "a right checksum of the chunk " + type, "a wrong one", "write it again"});
    }
    const std::string data = bytes.substr(offset + 8, length);
    const size_t end = data.find('\0');
    if (type == "tEXt" && end != std::string::npos) {
      texts.emplace_back(data.substr(0, end), data.substr(end + 1));
    }
    // Only uncompressed texts without language, as this program writes them.
    if (type == "iTXt" && end != std::string::npos && data.compare(end, 5, std::string(5, '\0')) == 0) {
      texts.emplace_back(data.substr(0, end), data.substr(end + 5));
    }
    offset += 12 + length;
  }
  return texts;
}

}  // namespace gld
