#include "datasets/images/heif_file.h"

#include "datasets/images/image_file.h"
#include "datasets/images/image_format.h"
#include "datasets/images/image_probe.h"
#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <cstdlib>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <libheif/heif.h>

namespace gld {
namespace {

using test::error_of;
using testing::HasSubstr;

constexpr int kWidth = 48, kHeight = 32;

// Smooth, so that little is lost by compression; no two corners are alike.
Image drawn() {
  Image image(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      uint8_t* pixel = image.pixel(x, y);
      pixel[0] = static_cast<uint8_t>(5 * x);
      pixel[1] = static_cast<uint8_t>(7 * y);
      pixel[2] = static_cast<uint8_t>(60 + x + y);
    }
  }
  return image;
}

heif_error append(heif_context* /*context*/, const void* data, size_t size, void* to) {
  static_cast<std::string*>(to)->append(static_cast<const char*>(data), size);
  return {heif_error_Ok, heif_suberror_Unspecified, ""};
}

// Returns a file as libheif's encoder makes it: the picture as stored, shown turned by `orientation`.
std::string encoded(const Image& image, heif_orientation orientation, const std::string& exif = "") {
  const auto check = [](const heif_error& error) { EXPECT_EQ(error.code, heif_error_Ok) << error.message; };
  const std::unique_ptr<heif_context, void (*)(heif_context*)> context(heif_context_alloc(),
                                                                       heif_context_free);
  heif_encoder* encoder = nullptr;
  check(heif_context_get_encoder_for_format(context.get(), heif_compression_HEVC, &encoder));
  check(heif_encoder_set_lossy_quality(encoder, 95));
  heif_image* picture = nullptr;
  check(heif_image_create(kWidth, kHeight, heif_colorspace_RGB, heif_chroma_interleaved_RGB, &picture));
  check(heif_image_add_plane(picture, heif_channel_interleaved, kWidth, kHeight, 8));
  int stride = 0;
  uint8_t* rows = heif_image_get_plane(picture, heif_channel_interleaved, &stride);
  for (int y = 0; y < kHeight; ++y) {
    std::copy_n(image.pixel(0, y), 3 * kWidth, rows + y * stride);
  }
  heif_encoding_options* options = heif_encoding_options_alloc();
  options->image_orientation = orientation;
  heif_image_handle* handle = nullptr;
  check(heif_context_encode_image(context.get(), picture, encoder, options, &handle));
  if (!exif.empty()) {
    check(heif_context_add_exif_metadata(context.get(), handle, exif.data(), static_cast<int>(exif.size())));
  }
  std::string bytes;
  heif_writer writer{1, append};
  check(heif_context_write(context.get(), &writer, &bytes));
  heif_image_handle_release(handle);
  heif_encoding_options_free(options);
  heif_image_release(picture);
  heif_encoder_release(encoder);
  return bytes;
}

double mean_difference(const Image& a, const Image& b) {
  double sum = 0;
  for (size_t i = 0; i < a.rgb.size(); ++i) sum += std::abs(int{a.rgb[i]} - int{b.rgb[i]});
  return sum / static_cast<double>(a.rgb.size());
}

Image turned_left(const Image& image) {
  Image turned(image.height, image.width);
  for (int64_t y = 0; y < turned.height; ++y) {
    for (int64_t x = 0; x < turned.width; ++x) {
      for (int64_t c = 0; c < 3; ++c) {
        turned.rgb[static_cast<size_t>(3 * (y * turned.width + x) + c)] =
            image.pixel(image.width - 1 - y, x)[c];
      }
    }
  }
  return turned;
}

// A big-endian TIFF structure: orientation 6, and in the EXIF part a lens like one of 28 mm before 36x24 mm.
std::string exif_of_a_telephone() {
  using namespace std::string_literals;
  return "MM\0\x2A\0\0\0\x08"s +
         "\0\x02"
         "\x01\x12\0\x03\0\0\0\x01\0\x06\0\0"
         "\x87\x69\0\x04\0\0\0\x01\0\0\0\x26"
         "\0\0\0\0"s +
         "\0\x01"
         "\xA4\x05\0\x03\0\0\0\x01\0\x1C\0\0"
         "\0\0\0\0"s;
}

class HeifFile : public testing::Test {
 protected:
  std::filesystem::path written(const std::string& bytes) const {
    auto file = folder_.path() / "photo.heic";
    write_file_atomically(file, bytes);
    return file;
  }
  test::TemporaryFolder folder_;
};

TEST_F(HeifFile, PicturesOfTelephonesAreRead) {
  const auto file = written(encoded(drawn(), heif_orientation_normal));
  EXPECT_EQ(image_format(read_file(file)), ImageFormat::kHeif);
  const Image read = read_image(file);
  ASSERT_EQ(read.width, kWidth);
  ASSERT_EQ(read.height, kHeight);
  EXPECT_LT(mean_difference(read, drawn()), 2.5);
}

// The file turns the picture itself; the EXIF of cameras says the same once more, and is not obeyed twice.
TEST_F(HeifFile, IsTurnedAsItIsShown) {
  const auto file = written(encoded(drawn(), heif_orientation_rotate_270_cw, exif_of_a_telephone()));
  const ImageFileInfo info = probe_image_file(file);
  EXPECT_EQ(info.width, kHeight);
  EXPECT_EQ(info.height, kWidth);
  EXPECT_EQ(info.orientation, 1);
  EXPECT_NEAR(info.focal_length, 28 * std::hypot(kWidth, kHeight) / kWidth / std::hypot(36, 24), 1e-9);
  for (const auto orientation : {ImageOrientation::kAsStored, ImageOrientation::kUpright}) {
    const Image read = read_image(file, orientation);
    ASSERT_EQ(read.width, kHeight);
    EXPECT_LT(mean_difference(read, turned_left(drawn())), 2.5);
  }
}

TEST_F(HeifFile, DamageIsSaidInASentence) {
  const std::string whole = encoded(drawn(), heif_orientation_normal);
  EXPECT_THAT(error_of([&] { read_image(written(whole.substr(0, whole.size() - 40))); }),
              HasSubstr("photo.heic: expected"));
  EXPECT_THAT(error_of([&] { read_image(written(whole.substr(0, 40))); }), HasSubstr("photo.heic: expected"));
  EXPECT_THAT(error_of([&] { read_image(written(whole.substr(0, 24) + std::string(400, '\0'))); }),
              HasSubstr("damaged data (libheif: "));
}

}  // namespace
}  // namespace gld
