#include "datasets/images/image_file.h"

#include "datasets/images/image_probe.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "tests/support/data_folders.h"
#include "tests/support/depth_png.h"
#include "tests/support/error_of.h"
#include "tests/support/exif_jpeg.h"
#include "tests/support/resident_memory.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <zlib.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;

Image gradient(int64_t width, int64_t height) {
  Image image(width, height);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      image.pixel(x, y)[0] = static_cast<uint8_t>(17 * x);
      image.pixel(x, y)[1] = static_cast<uint8_t>(29 * y);
      image.pixel(x, y)[2] = static_cast<uint8_t>(x + y);
    }
  }
  return image;
}

// A minimal big-endian EXIF segment that says only the orientation.
std::string exif_segment(char orientation) {
  std::string tiff("MM\0\x2A\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0", 19);
  tiff += orientation;
  tiff += std::string("\0\0\0\0\0\0", 6);
  const std::string body = std::string("Exif\0\0", 6) + tiff;
  const size_t length = body.size() + 2;
  return std::string("\xFF\xE1") + static_cast<char>(length >> 8) + static_cast<char>(length & 0xFF) + body;
}

TEST(ImageFile, PngKeepsEveryByte) {
  const TemporaryFolder folder;
  const Image image = gradient(13, 7);
  write_png(folder.path() / "a.png", image);
  const Image read = read_image(folder.path() / "a.png");
  EXPECT_EQ(read.width, 13);
  EXPECT_EQ(read.height, 7);
  EXPECT_EQ(read.rgb, image.rgb);
}

TEST(ImageFile, SixteenBitsGreyAndAlphaBecomeEightBitColour) {
  const TemporaryFolder folder;
  cv::Mat grey16(2, 3, CV_16UC1, cv::Scalar(0));
  grey16.at<uint16_t>(0, 1) = 65535;
  grey16.at<uint16_t>(1, 2) = 257 * 100 + 60;
  cv::imwrite((folder.path() / "grey16.png").string(), grey16);
  const Image grey = read_image(folder.path() / "grey16.png");
  EXPECT_EQ(grey.pixel(1, 0)[0], 255);
  EXPECT_EQ(grey.pixel(2, 1)[0], 100);
  EXPECT_EQ(grey.pixel(2, 1)[2], 100);

  cv::Mat bgra(2, 2, CV_8UC4, cv::Scalar(10, 20, 30, 255));
  bgra.at<cv::Vec4b>(0, 1) = {0, 0, 0, 0};
  bgra.at<cv::Vec4b>(1, 1) = {0, 0, 100, 51};
  cv::imwrite((folder.path() / "alpha.png").string(), bgra);
  const Image alpha = read_image(folder.path() / "alpha.png");
  EXPECT_EQ(std::vector<int>(alpha.pixel(0, 0), alpha.pixel(0, 0) + 3), (std::vector<int>{30, 20, 10}));
  EXPECT_EQ(std::vector<int>(alpha.pixel(1, 0), alpha.pixel(1, 0) + 3), (std::vector<int>{255, 255, 255}));
  EXPECT_EQ(std::vector<int>(alpha.pixel(1, 1), alpha.pixel(1, 1) + 3), (std::vector<int>{224, 204, 204}));
}

TEST(ImageFile, ExifSaysTheFocalLength) {
  const test::TemporaryFolder folder;
  const auto focal_length = [&](const test::ExifEntries& exif) {
    const auto file = folder.path() / "picture.jpg";
    write_jpeg(file, Image(48, 36), 90);
    test::add_exif(file, exif);
    return probe_image_file(file).focal_length;
  };
  EXPECT_EQ(focal_length({}), 0);
  // 4:3 beside 3:2 film: the same angle over the diagonals, 60 pixels and 43.27 mm.
  test::ExifEntries film;
  film.focal_length_in_35mm_film = 28;
  EXPECT_NEAR(focal_length(film), 28 / std::hypot(36.0, 24.0) * 60 / 48, 1e-12);
  // 50 mm on a sensor of 100 pixels a cm, 480 across: 500 pixels of 480; the picture is a copy a tenth as large.
  test::ExifEntries sensor;
  sensor.focal_length = 50;
  sensor.focal_plane_x_resolution = 100;
  sensor.focal_plane_unit = 3;
  sensor.pixel_x = 480;
  sensor.pixel_y = 360;
  EXPECT_NEAR(focal_length(sensor), 500.0 / 480, 1e-12);
  // Cut to another shape, nothing is known.
  sensor.pixel_y = 300;
  EXPECT_EQ(focal_length(sensor), 0);
}

TEST(ImageFile, ExifRotationIsAppliedOnlyWhenAsked) {
  const TemporaryFolder folder;
  // Four quadrants of different brightness show every turn and mirror.
  Image quadrants(32, 16);
  for (int64_t y = 0; y < 16; ++y) {
    for (int64_t x = 0; x < 32; ++x) {
      const int value = 40 + 60 * static_cast<int>(x / 16) + 120 * static_cast<int>(y / 8);
      for (int c = 0; c < 3; ++c) quadrants.pixel(x, y)[c] = static_cast<uint8_t>(value > 255 ? 255 : value);
    }
  }
  // What the upright picture shows at its top left, top right, bottom left, bottom right.
  const std::vector<std::vector<int>> expected{{40, 100, 160, 220}, {100, 40, 220, 160}, {220, 160, 100, 40},
                                               {160, 220, 40, 100}, {40, 160, 100, 220}, {160, 40, 220, 100},
                                               {220, 100, 160, 40}, {100, 220, 40, 160}};
  for (int orientation = 1; orientation <= 8; ++orientation) {
    const auto file = folder.path() / (std::to_string(orientation) + ".jpg");
    write_jpeg(file, quadrants, 100);
    test::ExifEntries exif;
    exif.orientation = static_cast<uint16_t>(orientation);
    test::add_exif(file, exif);
    const ImageFileInfo info = probe_image_file(file);
    EXPECT_EQ(info.orientation, orientation);
    EXPECT_EQ(info.width, 32);
    EXPECT_EQ(info.turned(), orientation >= 5);
    const Image stored = read_image(file);
    EXPECT_EQ(stored.width, 32);
    EXPECT_NEAR(stored.pixel(3, 3)[0], 40, 4);
    const Image upright = read_image(file, ImageOrientation::kUpright);
    ASSERT_EQ(upright.width, orientation >= 5 ? 16 : 32);
    ASSERT_EQ(upright.height, orientation >= 5 ? 32 : 16);
    const auto& corners = expected[static_cast<size_t>(orientation - 1)];
    EXPECT_NEAR(upright.pixel(3, 3)[1], corners[0], 4) << orientation;
    EXPECT_NEAR(upright.pixel(upright.width - 4, 3)[1], corners[1], 4) << orientation;
    EXPECT_NEAR(upright.pixel(3, upright.height - 4)[1], corners[2], 4) << orientation;
    EXPECT_NEAR(upright.pixel(upright.width - 4, upright.height - 4)[1], corners[3], 4) << orientation;
  }
}

uint32_t checksum(const std::string& bytes) {
  return static_cast<uint32_t>(
      crc32(0, reinterpret_cast<const Bytef*>(bytes.data()), static_cast<uInt>(bytes.size())));
}

std::string big_endian(uint32_t value) {
  std::string bytes;
  for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>(value >> shift & 255);
  return bytes;
}

// Two entries, little-endian: the maker and the orientation.
std::string little_endian_tiff(char orientation) {
  std::string tiff("II\x2A\0\x08\0\0\0\x02\0", 10);
  tiff += std::string("\x0F\x01\x02\0\x04\0\0\0abc\0", 12);
  tiff += std::string("\x12\x01\x03\0\x01\0\0\0", 8) + orientation + std::string("\0\0\0", 3);
  return tiff + std::string("\0\0\0\0", 4);
}

void write_png_with_exif(const std::filesystem::path& file, const std::string& tiff) {
  write_png(file, gradient(8, 4));
  const std::string bytes = read_file(file);
  constexpr size_t kHeaderEnd = 33;
  const std::string body = "eXIf" + tiff;
  write_file_atomically(file, bytes.substr(0, kHeaderEnd) + big_endian(static_cast<uint32_t>(tiff.size())) +
                                  body + big_endian(checksum(body)) + bytes.substr(kHeaderEnd));
}

TEST(ImageFile, ExifOfPngIsReadWhateverItsByteOrder) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "turned.png";
  for (char orientation = 1; orientation <= 8; ++orientation) {
    write_png_with_exif(file, little_endian_tiff(orientation));
    EXPECT_EQ(probe_image_file(file).orientation, orientation);
    EXPECT_EQ(read_image(file, ImageOrientation::kUpright).width, orientation >= 5 ? 4 : 8);
    write_png_with_exif(file, exif_segment(orientation).substr(10));
    EXPECT_EQ(probe_image_file(file).orientation, orientation);
  }
}

TEST(ImageFile, BrokenExifMeansAsStored) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "turned.png";
  const std::string whole = little_endian_tiff(6);
  testing::internal::CaptureStderr();
  for (size_t size = 0; size + 8 < whole.size(); ++size) {
    write_png_with_exif(file, whole.substr(0, size));
    EXPECT_EQ(probe_image_file(file).orientation, 1) << size;
  }
  for (const char value : {'\0', '\x09', '\x7f'}) {
    write_png_with_exif(file, little_endian_tiff(value));
    EXPECT_EQ(probe_image_file(file).orientation, 1);
  }
  // A directory far behind the end, and more entries than there are.
  std::string far = whole, many = whole;
  far[7] = '\x7f';
  many[9] = '\x7f';
  write_png_with_exif(file, far);
  EXPECT_EQ(probe_image_file(file).orientation, 1);
  write_png_with_exif(file, many);
  probe_image_file(file);  // whatever it says, it says it without harm
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

TEST(ImageFile, RefusesWhatIsNoPicture) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.png";
  EXPECT_EQ(error_of([&] { read_image(file); }),
            file.string() + ": expected a file, found nothing; check the path.");
  write_file_atomically(file, "hello");
  EXPECT_EQ(
      error_of([&] { read_image(file); }),
      file.string() + ": expected a PNG, JPEG, WebP, TIFF or HEIC image, found something else; convert it.");
  std::vector<uint8_t> bmp;
  ASSERT_TRUE(cv::imencode(".bmp", cv::Mat(4, 4, CV_8UC3, cv::Scalar(1, 2, 3)), bmp));
  write_file_atomically(file, {bmp.begin(), bmp.end()});
  EXPECT_EQ(
      error_of([&] { read_image(file); }),
      file.string() + ": expected a PNG, JPEG, WebP, TIFF or HEIC image, found something else; convert it.");
  write_file_atomically(file, "");
  EXPECT_EQ(
      error_of([&] { read_image(file); }),
      file.string() + ": expected a PNG, JPEG, WebP, TIFF or HEIC image, found an empty file; convert it.");
  write_png(file, Image(1, 5));
  EXPECT_EQ(error_of([&] { read_image(file); }),
            file.string() + ": expected an image at least 2 pixels wide and high, found 1x5; leave it out.");
}

TEST(ImageFile, RefusesFilesThatEndEarlyAtAnyByte) {
  const TemporaryFolder folder;
  write_png(folder.path() / "whole.png", gradient(40, 30));
  write_jpeg(folder.path() / "whole.jpg", gradient(40, 30), 90);
  for (const char* extension : {".png", ".jpg"}) {
    const std::string bytes = read_file(folder.path() / (std::string("whole") + extension));
    const auto file = folder.path() / (std::string("cut") + extension);
    for (size_t size = 8; size < bytes.size(); size += 1 + size / 16) {
      write_file_atomically(file, bytes.substr(0, size));
      EXPECT_EQ(error_of([&] { read_image(file); }),
                file.string() +
                    ": expected a whole image file, found one that ends early; copy or download it again.")
          << size;
    }
  }
}

// libpng makes room for what a chunk says, and takes one beyond its limit for a warning.
TEST(ImageFile, APngChunkThatTheFileCannotHoldTakesNoMemory) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.png";
  write_png(file, gradient(40, 30));
  const std::string whole = read_file(file);
  const std::string gigabyte("\x40\0\0\x19", 4);
  const size_t behind_header = 8 + 25;
  const size_t before_end = whole.size() - 12;
  for (const char* type : {"tEXt", "zTXt", "iTXt", "eXIf", "iCCP", "sPLT", "prVt"}) {
    for (const std::string& bytes :
         {whole.substr(0, behind_header) + gigabyte + type + "name" + whole.substr(behind_header),
          whole.substr(0, before_end) + gigabyte + type + "name" + whole.substr(before_end),
          whole.substr(0, behind_header) + gigabyte + type}) {
      SCOPED_TRACE(type + std::to_string(bytes.size()));
      write_file_atomically(file, bytes);
      test::expect_little_memory([&] {
        EXPECT_EQ(error_of([&] { read_image(file); }),
                  file.string() +
                      ": expected a whole image file, found one that ends early; copy or download it again.");
      });
    }
  }
}

TEST(ImageFile, TheEndIsFoundWithoutDecoding) {
  const TemporaryFolder folder;
  write_png(folder.path() / "whole.png", gradient(40, 30));
  write_jpeg(folder.path() / "whole.jpg", gradient(40, 30), 90);
  // A small picture in the metadata has an end of its own.
  const std::string jpeg = read_file(folder.path() / "whole.jpg");
  const std::string thumbnail = exif_segment(1) + "\xFF\xE1" + std::string("\0\x04\xFF\xD9", 4);
  write_file_atomically(folder.path() / "whole.jpg", jpeg.substr(0, 2) + thumbnail + jpeg.substr(2));
  for (const char* extension : {".png", ".jpg"}) {
    const std::string bytes = read_file(folder.path() / (std::string("whole") + extension));
    const auto file = folder.path() / (std::string("cut") + extension);
    write_file_atomically(file, bytes + "what a telephone adds");
    EXPECT_NO_THROW(check_image_end(file)) << extension;
    for (size_t size = 8; size < bytes.size(); size += 1 + size / 16) {
      write_file_atomically(file, bytes.substr(0, size));
      EXPECT_EQ(error_of([&] { check_image_end(file); }),
                file.string() +
                    ": expected a whole image file, found one that ends early; copy or download it again.")
          << size;
    }
  }
}

TEST(ImageFile, DamagedPixelDataIsRefused) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.png";
  write_png(file, gradient(64, 64));
  std::string bytes = read_file(file);
  for (size_t i = 60; i < bytes.size() - 30; i += 3) bytes[i] = static_cast<char>(bytes[i] ^ 0x5A);
  write_file_atomically(file, bytes);
  EXPECT_THAT(
      error_of([&] { read_image(file); }),
      testing::MatchesRegex(".*: expected an image that can be decoded, found damaged data \\(libpng: .*\\); "
                            "copy or download it again\\."));
}

// A picture with edges and noise, so that every block of a JPEG file has something to lose.
Image textured(int64_t width, int64_t height) {
  Image image(width, height);
  uint32_t noise = 1;
  for (size_t i = 0; i < image.rgb.size(); ++i) {
    noise = noise * 1664525 + 1013904223;
    image.rgb[i] = static_cast<uint8_t>((i / 96 * 53 + (noise >> 26)) % 256);
  }
  return image;
}

TEST(ImageFile, JpegHasTheBitsOfOpenCv) {
  const auto corpus = test::source_root() / "tests" / "fuzz" / "corpus" / "image";
  const TemporaryFolder folder;
  write_jpeg(folder.path() / "textured.jpg", textured(67, 45), 75);
  std::vector<std::filesystem::path> files = {folder.path() / "textured.jpg"};
  for (const char* name : {"colour.jpg", "progressive.jpg", "grey_progressive.jpg", "cmyk.jpg"})
    files.push_back(corpus / name);
  for (const auto& file : files) {
    const Image read = read_image(file);
    cv::Mat expected = cv::imread(file.string(), cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);
    ASSERT_EQ(expected.cols, read.width) << file;
    ASSERT_EQ(expected.rows, read.height) << file;
    for (int64_t y = 0; y < read.height; ++y) {
      for (int64_t x = 0; x < read.width; ++x) {
        const auto& bgr = expected.at<cv::Vec3b>(static_cast<int>(y), static_cast<int>(x));
        for (int c = 0; c < 3; ++c)
          ASSERT_EQ(read.pixel(x, y)[c], bgr[2 - c]) << file << " " << x << " " << y;
      }
    }
  }
}

// JPEG files have no checksum, so that some damage cannot be seen; what libjpeg sees must not pass, and neither library
// may print anything.
TEST(ImageFile, DamageThatTheLibrariesSeeIsRefusedWithoutTheirChatter) {
  const TemporaryFolder folder;
  write_jpeg(folder.path() / "whole.jpg", textured(160, 120), 85);
  write_png(folder.path() / "whole.png", textured(160, 120));
  for (const char* extension : {".jpg", ".png"}) {
    const std::string whole = read_file(folder.path() / (std::string("whole") + extension));
    const auto file = folder.path() / (std::string("damaged") + extension);
    int refused = 0;
    constexpr int kFiles = 250;
    testing::internal::CaptureStderr();
    testing::internal::CaptureStdout();
    for (int i = 0; i < kFiles; ++i) {
      // Three bytes of the pixels' data become others.
      std::string bytes = whole;
      for (size_t k = 0; k < 3; ++k) {
        const size_t at = 700 + (static_cast<size_t>(i) * 7919 + k * 3571) % (bytes.size() - 720);
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
    EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
    EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
    const bool png = std::string(extension) == ".png";
    EXPECT_GE(refused, png ? kFiles : kFiles / 2) << extension;
  }
}

TEST(ImageFile, APictureLargerThanAnyCamerasIsNotUnpacked) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "a.png";
  write_png(file, gradient(8, 8));
  std::string bytes = read_file(file);
  for (const auto& [width, height] :
       {std::pair<uint32_t, uint32_t>{24000, 24000}, {65536, 2}, {0x80000000U, 2}}) {
    SCOPED_TRACE(width);
    for (size_t i = 0; i < 4; ++i) {
      bytes[16 + i] = static_cast<char>(width >> (24 - 8 * i));
      bytes[20 + i] = static_cast<char>(height >> (24 - 8 * i));
    }
    const auto checksum =
        static_cast<uint32_t>(crc32(0, reinterpret_cast<const Bytef*>(bytes.data()) + 12, 17));
    for (size_t i = 0; i < 4; ++i) bytes[29 + i] = static_cast<char>(checksum >> (24 - 8 * i));
    write_file_atomically(file, bytes);
    if (width == 0x80000000U) {  // a PNG file's numbers have 31 bits
      EXPECT_THAT(error_of([&] { read_image(file); }), testing::HasSubstr("found damaged data (libpng: "));
      continue;
    }
    EXPECT_EQ(error_of([&] { read_image(file); }),
              file.string() +
                  ": expected a size of 1x1 to 268 million pixels, each side at most 65535, found " +
                  std::to_string(width) + "x" + std::to_string(height) +
                  "; check the file, or scale the picture down.");
  }
}

TEST(ImageFile, DepthPngKeepsMillimetres) {
  const TemporaryFolder folder;
  DepthMap depth(4, 2);
  depth.metres = {0, 0.001F, 1.2345F, 65.535F, 100, 3, 2, 1};
  test::write_depth_png(folder.path() / "d.png", depth, 1e-3);
  const DepthMap read = read_depth_png(folder.path() / "d.png", 1e-3);
  EXPECT_EQ(read.metres[0], 0);
  EXPECT_NEAR(read.metres[2], 1.2345, 5.1e-4);
  EXPECT_NEAR(read.metres[4], 65.535, 1e-4);
  write_png(folder.path() / "colour.png", gradient(4, 4));
  EXPECT_EQ(error_of([&] { read_depth_png(folder.path() / "colour.png", 1e-3); }),
            (folder.path() / "colour.png").string() +
                ": expected a 16-bit image with one channel, found another pixel type; "
                "write depth as 16-bit grey PNG.");
}

}  // namespace
}  // namespace gld
