// Image files at the ends of what they can hold.
#include "bench/extremes/extremes_benchmark.h"
#include "datasets/images/image_file.h"
#include "datasets/images/image_probe.h"
#include "datasets/scenes/resize_crop.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <png.h>

namespace gld {
namespace {

// Returns the largest difference of a picture's pixels from one colour.
double largest_difference(const Image& image, const std::array<int, 3>& colour) {
  int largest = image.empty() ? 255 : 0;
  for (size_t i = 0; i < image.rgb.size(); ++i) {
    largest = std::max(largest, std::abs(static_cast<int>(image.rgb[i]) - colour[i % 3]));
  }
  return largest;
}

// Writes a PNG file of one value a channel: grey; red, green, blue; or these and alpha.
void write_one_colour(const std::filesystem::path& file, int bits, const std::vector<int>& channels) {
  constexpr png_uint_32 kWidth = 9, kHeight = 6;
  const std::unique_ptr<FILE, int (*)(FILE*)> stream(std::fopen(file.c_str(), "wb"), &std::fclose);
  if (stream == nullptr) fail({file.string(), "a file that can be written", "none", "free space there"});
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  png_init_io(png, stream.get());
  const int kind = channels.size() == 1   ? PNG_COLOR_TYPE_GRAY
                   : channels.size() == 3 ? PNG_COLOR_TYPE_RGB
                                          : PNG_COLOR_TYPE_RGB_ALPHA;
  png_set_IHDR(png, info, kWidth, kHeight, bits, kind, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  std::vector<png_byte> row;
  for (png_uint_32 x = 0; x < kWidth; ++x) {
    for (const int value : channels) {
      if (bits == 16) row.push_back(static_cast<png_byte>(value >> 8));
      row.push_back(static_cast<png_byte>(value & 0xFF));
    }
  }
  for (png_uint_32 y = 0; y < kHeight; ++y) png_write_row(png, row.data());
  png_write_end(png, info);
  png_destroy_write_struct(&png, &info);
}

double error_after_reading(const std::filesystem::path& file, int bits, const std::vector<int>& channels,
                           const std::array<int, 3>& colour) {
  write_one_colour(file, bits, channels);
  return largest_difference(read_image(file), colour);
}

// Returns the bytes of a JPEG file with an EXIF segment that says only the orientation.
std::string with_orientation(const std::string& jpeg, int orientation) {
  std::string tiff("MM\0\x2A\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0", 19);
  tiff += static_cast<char>(orientation);
  tiff += std::string("\0\0\0\0\0\0", 6);
  const std::string body = std::string("Exif\0\0", 6) + tiff;
  const auto length = static_cast<int>(body.size()) + 2;
  return jpeg.substr(0, 2) + "\xFF\xE1" + static_cast<char>(length >> 8) + static_cast<char>(length & 0xFF) +
         body + jpeg.substr(2);
}

// Returns the brightness at the four corners of an upright picture, from the top left, row by row.
std::array<int, 4> corners(const Image& image) {
  constexpr int64_t kInset = 3;
  const int64_t right = image.width - 1 - kInset, bottom = image.height - 1 - kInset;
  return {image.pixel(kInset, kInset)[1], image.pixel(right, kInset)[1], image.pixel(kInset, bottom)[1],
          image.pixel(right, bottom)[1]};
}

// Returns the largest error of the corners over the eight orientations of a picture whose quadrants differ.
double orientation_error(const std::filesystem::path& folder) {
  Image quadrants(32, 16);
  for (int64_t y = 0; y < quadrants.height; ++y) {
    for (int64_t x = 0; x < quadrants.width; ++x) {
      const auto value = static_cast<uint8_t>(40 + 60 * (x / 16) + 120 * (y / 8));
      std::fill_n(quadrants.pixel(x, y), 3, value);
    }
  }
  const std::array<std::array<int, 4>, 8> upright{{{40, 100, 160, 220},
                                                   {100, 40, 220, 160},
                                                   {220, 160, 100, 40},
                                                   {160, 220, 40, 100},
                                                   {40, 160, 100, 220},
                                                   {160, 40, 220, 100},
                                                   {220, 100, 160, 40},
                                                   {100, 220, 40, 160}}};
  const auto stored = folder / "stored.jpg", turned = folder / "turned.jpg";
  write_jpeg(stored, quadrants, 100);
  double largest = 0;
  for (int orientation = 1; orientation <= 8; ++orientation) {
    write_file_atomically(turned, with_orientation(read_file(stored), orientation));
    const auto found = corners(read_image(turned, ImageOrientation::kUpright));
    for (size_t i = 0; i < found.size(); ++i) {
      largest = std::max(largest, static_cast<double>(
                                      std::abs(found[i] - upright[static_cast<size_t>(orientation - 1)][i])));
    }
  }
  return largest;
}

void add_refusals(std::vector<ExtremeRow>& rows, const std::filesystem::path& folder) {
  for (const auto& [width, height] : {std::pair<int64_t, int64_t>{1, 28}, {28, 1}}) {
    write_png(folder / "thin.png", Image(width, height));
    write_jpeg(folder / "thin.jpg", Image(width, height), 90);
    for (const char* file : {"thin.png", "thin.jpg"}) {
      const auto path = folder / file;
      rows.push_back({"images", fmt::format("{} x {} pixels, {}", width, height, path.extension().string()),
                      "accepted",
                      accepted([&] { read_image(path); }) + accepted([&] { probe_image_file(path); }), 0});
    }
  }
}

// Returns how far the camera's rays through the corners of a 1:8 picture move when it is resized and cropped, in pixels
// of the result: a point of the scene has to stay on the pixel that shows it.
double aspect_error() {
  Camera camera;
  camera.width = 801;
  camera.height = 100;
  camera.intrinsics << 700, 0, 390, 0, 650, 51, 0, 0, 1;
  const auto plan = plan_resize_crop(camera.width, camera.height, {112, 14});
  const Camera resized = resize_crop(camera, plan);
  double largest = 0;
  for (const Eigen::Vector2d& corner : {Eigen::Vector2d(0, 0), Eigen::Vector2d(801, 100)}) {
    const Eigen::Vector3d ray = camera.intrinsics.inverse() * corner.homogeneous();
    const Eigen::Vector2d found = (resized.intrinsics * ray).head<2>();
    const Eigen::Vector2d expected(
        corner.x() * static_cast<double>(plan.resized_width) / 801 - static_cast<double>(plan.left),
        corner.y() * static_cast<double>(plan.resized_height) / 100 - static_cast<double>(plan.top));
    largest = std::max(largest, (found - expected).cwiseAbs().maxCoeff());
  }
  return largest;
}

}  // namespace

std::vector<ExtremeRow> image_extremes(const std::filesystem::path& folder) {
  std::vector<ExtremeRow> rows;
  const auto file = folder / "picture.png";
  const auto add = [&](const char* situation, double error, double limit) {
    rows.push_back({"images", situation, "largest error of a channel, of 255", error, limit});
  };
  add("8-bit colour", error_after_reading(file, 8, {10, 20, 30}, {10, 20, 30}), 0);
  add("all black", error_after_reading(file, 8, {0, 0, 0}, {0, 0, 0}), 0);
  add("all white", error_after_reading(file, 8, {255, 255, 255}, {255, 255, 255}), 0);
  add("16-bit colour", error_after_reading(file, 16, {0, 257 * 100 + 60, 65535}, {0, 100, 255}), 0);
  add("8-bit grey", error_after_reading(file, 8, {77}, {77, 77, 77}), 0);
  add("16-bit grey", error_after_reading(file, 16, {257 * 100 + 60}, {100, 100, 100}), 0);
  add("alpha 0 over white", error_after_reading(file, 8, {0, 0, 0, 0}, {255, 255, 255}), 0);
  add("alpha 0.2 over white", error_after_reading(file, 8, {100, 0, 0, 51}, {224, 204, 204}), 0);
  add("the eight EXIF orientations of a JPEG", orientation_error(folder), 4);
  rows.push_back({"images", "8:1 picture resized and cropped", "shift of a point against its pixel, pixels",
                  aspect_error(), 1e-9});
  add_refusals(rows, folder);
  return rows;
}

}  // namespace gld
