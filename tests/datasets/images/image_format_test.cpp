#include "datasets/images/image_format.h"

#include "datasets/images/image_file.h"
#include "datasets/images/image_probe.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cstring>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;

// Blue, green, red, with edges and noise: every block has something to lose.
cv::Mat noisy(int width, int height, int type = CV_8UC3) {
  cv::Mat image(height, width, type);
  uint32_t noise = 1;
  uint8_t* bytes = image.data;
  for (size_t i = 0; i < image.total() * image.elemSize(); ++i) {
    noise = noise * 1664525 + 1013904223;
    bytes[i] = static_cast<uint8_t>((i / 96 * 53 + (noise >> 25)) % 256);
  }
  return image;
}

std::string encoded(const std::string& extension, const cv::Mat& image, const std::vector<int>& settings) {
  std::vector<uint8_t> bytes;
  EXPECT_TRUE(cv::imencode(extension, image, bytes, settings));
  return {bytes.begin(), bytes.end()};
}

const std::vector<int> kLosslessWebp{cv::IMWRITE_WEBP_QUALITY, 101};
std::vector<int> tiff_compression(int compression) { return {cv::IMWRITE_TIFF_COMPRESSION, compression}; }

std::vector<int> rgb_at(const Image& image, int64_t x, int64_t y) {
  const uint8_t* pixel = image.pixel(x, y);
  return {pixel[0], pixel[1], pixel[2]};
}

void expect_pixels(const std::filesystem::path& file, const cv::Mat& bgr, const std::string& what) {
  const Image read = read_image(file);
  ASSERT_EQ(read.width, bgr.cols) << what;
  ASSERT_EQ(read.height, bgr.rows) << what;
  for (int y = 0; y < bgr.rows; ++y) {
    for (int x = 0; x < bgr.cols; ++x) {
      const auto& pixel = bgr.at<cv::Vec3b>(y, x);
      ASSERT_EQ(rgb_at(read, x, y), (std::vector<int>{pixel[2], pixel[1], pixel[0]}))
          << what << " " << x << " " << y;
    }
  }
}

TEST(ImageFormat, IsToldByTheFirstBytesWhateverTheName) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "photo.png";
  const cv::Mat image = noisy(37, 21);
  const std::vector<std::pair<std::string, std::vector<int>>> kinds{{".webp", kLosslessWebp},
                                                                    {".tiff", tiff_compression(1)},
                                                                    {".tiff", tiff_compression(5)},
                                                                    {".tiff", tiff_compression(8)},
                                                                    {".tiff", tiff_compression(32773)}};
  for (const auto& [extension, settings] : kinds) {
    write_file_atomically(file, encoded(extension, image, settings));
    const ImageFileInfo info = probe_image_file(file);
    EXPECT_EQ(info.width, 37) << extension;
    EXPECT_EQ(info.height, 21) << extension;
    EXPECT_EQ(info.orientation, 1) << extension;
    expect_pixels(file, image, extension);
  }
}

TEST(ImageFormat, LossyWebpHasTheBitsOfOpenCv) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.webp";
  write_file_atomically(file, encoded(".webp", noisy(67, 45), {cv::IMWRITE_WEBP_QUALITY, 80}));
  expect_pixels(file, cv::imread(file.string(), cv::IMREAD_COLOR), "lossy");
}

TEST(ImageFormat, GreySixteenBitsAndAlphaBecomeEightBitColour) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a";
  cv::Mat grey16(2, 3, CV_16UC1, cv::Scalar(0));
  grey16.at<uint16_t>(0, 1) = 65535;
  grey16.at<uint16_t>(1, 2) = 257 * 100 + 60;
  write_file_atomically(file, encoded(".tiff", grey16, {}));
  EXPECT_EQ(rgb_at(read_image(file), 1, 0), (std::vector<int>{255, 255, 255}));
  EXPECT_EQ(rgb_at(read_image(file), 2, 1), (std::vector<int>{100, 100, 100}));

  cv::Mat grey(2, 5, CV_8UC1, cv::Scalar(7));
  grey.at<uint8_t>(1, 4) = 200;
  for (const char* extension : {".tiff", ".webp"}) {
    write_file_atomically(file, encoded(extension, grey, kLosslessWebp));
    EXPECT_EQ(rgb_at(read_image(file), 0, 0), (std::vector<int>{7, 7, 7})) << extension;
    EXPECT_EQ(rgb_at(read_image(file), 4, 1), (std::vector<int>{200, 200, 200})) << extension;
  }

  cv::Mat bgra(2, 2, CV_8UC4, cv::Scalar(10, 20, 30, 255));
  bgra.at<cv::Vec4b>(0, 1) = {0, 0, 0, 0};
  bgra.at<cv::Vec4b>(1, 1) = {0, 0, 100, 51};
  write_file_atomically(file, encoded(".webp", bgra, kLosslessWebp));
  EXPECT_EQ(rgb_at(read_image(file), 0, 0), (std::vector<int>{30, 20, 10}));
  EXPECT_EQ(rgb_at(read_image(file), 1, 0), (std::vector<int>{255, 255, 255}));
  EXPECT_EQ(rgb_at(read_image(file), 1, 1), (std::vector<int>{224, 204, 204}));
  // OpenCV does not say in TIFF files what the fourth channel is.
  write_file_atomically(file, encoded(".tiff", bgra, {}));
  EXPECT_EQ(rgb_at(read_image(file), 1, 1), (std::vector<int>{100, 0, 0}));
}

std::string little(uint64_t value, int bytes) {
  std::string text;
  for (int i = 0; i < bytes; ++i, value >>= 8) text += static_cast<char>(value & 255);
  return text;
}

constexpr uint64_t kShort = 3, kLong = 4;  // types of a tag's values

struct TiffTag {
  int number = 0;
  uint32_t value = 0;
  uint64_t type = kLong;
  uint64_t count = 1;
};

// One uncompressed strip of 8-bit grey; tags override those of the picture.
std::string grey_tiff(int width, int height, const std::string& pixels, const std::vector<TiffTag>& changed) {
  std::map<int, TiffTag> tags;
  std::vector<TiffTag> all{{256, static_cast<uint32_t>(width)},
                           {257, static_cast<uint32_t>(height)},
                           {258, 8},
                           {259, 1},
                           {262, 1},
                           {273, 8},
                           {274, 1},
                           {277, 1},
                           {278, static_cast<uint32_t>(height)},
                           {279, static_cast<uint32_t>(pixels.size())}};
  all.insert(all.end(), changed.begin(), changed.end());
  for (const TiffTag& tag : all) tags[tag.number] = tag;
  std::string file = std::string("II\x2A\0", 4) + little(8 + pixels.size(), 4) + pixels;
  file += little(tags.size(), 2);
  for (const auto& [number, tag] : tags) {
    file += little(static_cast<uint64_t>(number), 2) + little(tag.type, 2) + little(tag.count, 4) +
            little(tag.value, 4);
  }
  return file + little(0, 4);
}

TEST(ImageFormat, AlphaOfTiffLiesOverWhite) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a";
  // Grey and alpha, not multiplied with each other.
  const std::string pixels("\x64\xFF\x64\x00\x64\x33\x00\x33", 8);
  write_file_atomically(file,
                        grey_tiff(2, 2, pixels, {{277, 2}, {258, 8 | 8 << 16, kShort, 2}, {338, 2, kShort}}));
  const Image tiff = read_image(file);
  EXPECT_EQ(rgb_at(tiff, 0, 0), (std::vector<int>{100, 100, 100}));
  EXPECT_EQ(rgb_at(tiff, 1, 0), (std::vector<int>{255, 255, 255}));
  EXPECT_EQ(rgb_at(tiff, 0, 1), (std::vector<int>{224, 224, 224}));
  EXPECT_EQ(rgb_at(tiff, 1, 1), (std::vector<int>{204, 204, 204}));
}

TEST(ImageFormat, TiffOrientationIsThatOfExif) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.tif";
  const std::string pixels("\x01\x02\x03\x04\x05\x06", 6);
  for (uint32_t orientation = 1; orientation <= 8; ++orientation) {
    write_file_atomically(file, grey_tiff(3, 2, pixels, {{274, orientation}}));
    const ImageFileInfo info = probe_image_file(file);
    EXPECT_EQ(info.orientation, static_cast<int>(orientation));
    EXPECT_EQ(info.width, 3);
    const Image stored = read_image(file);
    EXPECT_EQ(stored.pixel(0, 0)[0], 1) << orientation;
    EXPECT_EQ(stored.pixel(2, 1)[0], 6) << orientation;
    EXPECT_EQ(read_image(file, ImageOrientation::kUpright).width, orientation >= 5 ? 2 : 3);
  }
  EXPECT_EQ(read_image(file, ImageOrientation::kUpright).pixel(0, 0)[0], 3);  // 8: turned to the left
}

std::string riff_chunk(const std::string& name, const std::string& data) {
  return name + little(data.size(), 4) + data + (data.size() % 2 == 0 ? "" : std::string(1, '\0'));
}

std::string riff(const std::string& chunks) {
  return "RIFF" + little(4 + chunks.size(), 4) + "WEBP" + chunks;
}

std::string extended_header(int flags, int width, int height) {
  return riff_chunk("VP8X", little(static_cast<uint64_t>(flags), 4) +
                                little(static_cast<uint64_t>(width - 1), 3) +
                                little(static_cast<uint64_t>(height - 1), 3));
}

TEST(ImageFormat, ExifBehindThePixelsOfWebpIsFound) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.webp";
  const std::string picture = encoded(".webp", noisy(400, 300), kLosslessWebp).substr(12);
  ASSERT_GT(picture.size(), size_t{1} << 18);  // more than is read first
  const std::string tiff =
      std::string("MM\0\x2A\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0", 26);
  for (const std::string& start : {std::string(), std::string("Exif\0\0", 6)}) {
    write_file_atomically(file,
                          riff(extended_header(0x08, 400, 300) + picture + riff_chunk("EXIF", start + tiff)));
    EXPECT_EQ(probe_image_file(file).orientation, 6);
    EXPECT_EQ(read_image(file, ImageOrientation::kUpright).width, 300);
  }
}

TEST(ImageFormat, AnimationsAreRefused) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.webp";
  const std::string picture = encoded(".webp", noisy(8, 6), kLosslessWebp).substr(12);
  const std::string frame =
      riff_chunk("ANMF", little(0, 6) + little(7, 3) + little(5, 3) + little(40, 3) + little(0, 1) + picture);
  write_file_atomically(file,
                        riff(extended_header(0x02, 8, 6) + riff_chunk("ANIM", little(0, 6)) + frame + frame));
  EXPECT_EQ(error_of([&] { read_image(file); }),
            file.string() + ": expected one picture, found an animation of 2; save its frames as files.");
}

TEST(ImageFormat, FilesThatEndEarlyAreRefusedAtAnyByte) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "cut";
  testing::internal::CaptureStderr();
  for (const auto& [extension, settings] :
       std::vector<std::pair<std::string, std::vector<int>>>{{".webp", {cv::IMWRITE_WEBP_QUALITY, 80}},
                                                             {".webp", kLosslessWebp},
                                                             {".tiff", tiff_compression(1)},
                                                             {".tiff", tiff_compression(5)},
                                                             {".tiff", tiff_compression(8)},
                                                             {".tiff", tiff_compression(32773)}}) {
    const std::string bytes = encoded(extension, noisy(40, 30), settings);
    for (size_t size = 12; size < bytes.size(); size += 1 + size / 16) {
      write_file_atomically(file, bytes.substr(0, size));
      EXPECT_THAT(error_of([&] { read_image(file); }),
                  testing::AllOf(testing::StartsWith(file.string() + ": "),
                                 testing::EndsWith("; copy or download it again.")))
          << extension << " " << size;
    }
  }
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

TEST(ImageFormat, DamageThatTheLibrariesSeeIsRefusedWithoutTheirChatter) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "damaged";
  for (const auto& [extension, settings] : std::vector<std::pair<std::string, std::vector<int>>>{
           {".webp", kLosslessWebp}, {".tiff", tiff_compression(5)}, {".tiff", tiff_compression(8)}}) {
    const std::string whole = encoded(extension, noisy(80, 60), settings);
    int refused = 0;
    constexpr int kFiles = 100;
    testing::internal::CaptureStderr();
    testing::internal::CaptureStdout();
    for (int i = 0; i < kFiles; ++i) {
      std::string bytes = whole;
      for (size_t k = 0; k < 3; ++k) {
        const size_t at = 12 + (static_cast<size_t>(i) * 7919 + k * 3571) % (bytes.size() - 12);
        bytes[at] = static_cast<char>(bytes[at] ^ static_cast<char>(1 + i % 127));
      }
      write_file_atomically(file, bytes);
      try {
        read_image(file);
      } catch (const Error& error) {
        EXPECT_THAT(error.what(), testing::StartsWith(file.string() + ": "));
        ++refused;
      }
    }
    EXPECT_EQ(testing::internal::GetCapturedStdout(), "") << extension;
    EXPECT_EQ(testing::internal::GetCapturedStderr(), "") << extension;
    EXPECT_GE(refused, 5) << extension;  // neither has a checksum
  }
}

TEST(ImageFormat, SizesThatTheFileCannotHoldAreRefusedBeforeMemoryIsTaken) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a";
  // A lossless WebP file says its size in 14 bits each, behind one byte.
  std::string webp = encoded(".webp", cv::Mat(8, 8, CV_8UC3, cv::Scalar(1, 2, 3)), kLosslessWebp);
  for (size_t i = 0; i < 3; ++i) webp[21 + i] = '\xFF';
  webp[24] = static_cast<char>(webp[24] | 0x0F);
  write_file_atomically(file, webp);
  EXPECT_EQ(error_of([&] { read_image(file); }),
            file.string() + ": expected at most 4096 pixels for a byte of the file, found 16384x16384 in " +
                std::to_string(webp.size()) + " bytes; check the file, or scale the picture down.");

  const std::string pixels(6, '\x01');
  write_file_atomically(file, grey_tiff(3, 2, pixels, {{256, 24000}, {257, 24000}}));
  EXPECT_THAT(error_of([&] { read_image(file); }),
              testing::HasSubstr("expected a size of 1x1 to 268 million pixels"));
  write_file_atomically(file, grey_tiff(3, 2, pixels, {{256, 15000}, {257, 15000}}));
  EXPECT_EQ(
      error_of([&] { read_image(file); }),
      file.string() + ": expected a whole image file, found one that ends early; copy or download it again.");
  write_file_atomically(file, grey_tiff(3, 2, pixels, {{256, 15000}, {257, 15000}, {259, 5}}));
  EXPECT_THAT(error_of([&] { read_image(file); }), testing::HasSubstr("at most 4096 pixels for a byte"));
}

TEST(ImageFormat, OtherKindsOfTiffAreNamed) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.tif";
  const std::string pixels(24, '\x01');
  write_file_atomically(file, grey_tiff(3, 2, pixels, {{258, 32}}));
  EXPECT_EQ(error_of([&] { read_image(file); }),
            file.string() + ": expected 8 or 16 bits a channel, found another pixel type; convert it.");
  write_file_atomically(file, grey_tiff(3, 2, pixels, {{259, 50001}}));
  EXPECT_EQ(error_of([&] { read_image(file); }),
            file.string() +
                ": expected a TIFF file without compression, or with LZW, deflate, PackBits or JPEG, "
                "found compression 50001; convert it.");
  write_file_atomically(file, grey_tiff(3, 2, pixels, {{277, 9}}));
  EXPECT_EQ(error_of([&] { read_image(file); }),
            file.string() + ": expected 1 to 5 channels, found 9; convert it.");
}

// Which of them is meant cannot be known; a smaller copy of the first is no page.
TEST(ImageFormat, ATiffOfSeveralPagesIsRefused) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.tif";
  const auto two_pages = [](uint32_t kind_of_second) {
    std::string bytes = grey_tiff(3, 2, std::string("\x01\x02\x03\x04\x05\x06", 6), {{254, 0}});
    uint32_t directory = 0, end = 0;
    uint16_t entries = 0;
    std::memcpy(&directory, bytes.data() + 4, sizeof(directory));
    std::memcpy(&entries, bytes.data() + directory, sizeof(entries));
    const size_t next = directory + 2 + size_t{12} * entries;
    if (bytes.size() % 2 == 1) bytes += '\0';
    std::string second = bytes.substr(directory, next + 4 - directory);
    for (size_t entry = 2; entry + 12 <= second.size(); entry += 12) {
      uint16_t tag = 0;
      std::memcpy(&tag, second.data() + entry, sizeof(tag));
      if (tag == 254) std::memcpy(second.data() + entry + 8, &kind_of_second, sizeof(kind_of_second));
    }
    end = static_cast<uint32_t>(bytes.size());
    std::memcpy(bytes.data() + next, &end, sizeof(end));
    return bytes + second;
  };
  write_file_atomically(file, two_pages(0));
  EXPECT_EQ(error_of([&] { read_image(file); }),
            file.string() +
                ": expected a TIFF file of one page, found several; save the page as a file of its own.");
  write_file_atomically(file, two_pages(1));
  EXPECT_EQ(read_image(file).width, 3);
}

}  // namespace
}  // namespace gld
