#include "datasets/pictures/drawing.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include <cairo.h>
#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

cv::Mat view_of(const Image& image) {
  return cv::Mat(static_cast<int>(image.height), static_cast<int>(image.width), CV_8UC3,
                 const_cast<uint8_t*>(image.rgb.data()));
}

PixelRect clipped(const Image& image, const PixelRect& rect) {
  PixelRect result;
  result.x = std::clamp<int64_t>(rect.x, 0, image.width);
  result.y = std::clamp<int64_t>(rect.y, 0, image.height);
  result.width = std::clamp<int64_t>(rect.x + rect.width, result.x, image.width) - result.x;
  result.height = std::clamp<int64_t>(rect.y + rect.height, result.y, image.height) - result.y;
  return result;
}

TextFont font_of(const TextStyle& style) { return {static_cast<double>(style.size), style.weight}; }

}  // namespace

Image filled_image(int64_t width, int64_t height, const Rgb& colour) {
  Image image(width, height);
  fill_rect(image, {0, 0, width, height}, colour);
  return image;
}

void fill_rect(Image& image, const PixelRect& rect, const Rgb& colour) {
  const PixelRect inside = clipped(image, rect);
  for (int64_t y = inside.y; y < inside.y + inside.height; ++y) {
    for (int64_t x = inside.x; x < inside.x + inside.width; ++x) {
      std::copy(colour.begin(), colour.end(), image.pixel(x, y));
    }
  }
}

void paste(Image& image, const Image& picture, int64_t x, int64_t y) {
  const PixelRect inside = clipped(image, {x, y, picture.width, picture.height});
  for (int64_t row = 0; row < inside.height; ++row) {
    const uint8_t* from = picture.pixel(inside.x - x, inside.y - y + row);
    std::copy(from, from + 3 * inside.width, image.pixel(inside.x, inside.y + row));
  }
}

Image resized(const Image& picture, int64_t width, int64_t height) {
  if (picture.width == width && picture.height == height) return picture;
  Image result(width, height);
  cv::Mat target = view_of(result);
  const bool smaller = width < picture.width || height < picture.height;
  cv::resize(view_of(picture), target, target.size(), 0, 0, smaller ? cv::INTER_AREA : cv::INTER_CUBIC);
  return result;
}

void paint_with_cairo(Image& image, const PixelRect& rect, const std::function<void(cairo_t*)>& paint) {
  const PixelRect inside = clipped(image, rect);
  if (inside.width == 0 || inside.height == 0) return;
  const std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)> surface(
      cairo_image_surface_create(CAIRO_FORMAT_RGB24, static_cast<int>(inside.width),
                                 static_cast<int>(inside.height)),
      cairo_surface_destroy);
  if (cairo_surface_status(surface.get()) != CAIRO_STATUS_SUCCESS) {
    fail({"drawing", "cairo to make a picture", cairo_status_to_string(cairo_surface_status(surface.get())),
          ""});
  }
  uint8_t* const data = cairo_image_surface_get_data(surface.get());
  const int stride = cairo_image_surface_get_stride(surface.get());
  // cairo's pixel is a 32-bit number 0xRRGGBB, in the machine's byte order.
  const auto row_of = [&](int64_t y) { return reinterpret_cast<uint32_t*>(data + y * stride); };
  for (int64_t y = 0; y < inside.height; ++y) {
    for (int64_t x = 0; x < inside.width; ++x) {
      const uint8_t* pixel = image.pixel(inside.x + x, inside.y + y);
      row_of(y)[x] = static_cast<uint32_t>(pixel[0] << 16 | pixel[1] << 8 | pixel[2]);
    }
  }
  cairo_surface_mark_dirty(surface.get());
  const std::unique_ptr<cairo_t, decltype(&cairo_destroy)> cairo(cairo_create(surface.get()), cairo_destroy);
  cairo_translate(cairo.get(), static_cast<double>(-inside.x), static_cast<double>(-inside.y));
  paint(cairo.get());
  cairo_surface_flush(surface.get());
  for (int64_t y = 0; y < inside.height; ++y) {
    for (int64_t x = 0; x < inside.width; ++x) {
      const uint32_t value = row_of(y)[x];
      uint8_t* pixel = image.pixel(inside.x + x, inside.y + y);
      pixel[0] = static_cast<uint8_t>(value >> 16);
      pixel[1] = static_cast<uint8_t>(value >> 8);
      pixel[2] = static_cast<uint8_t>(value);
    }
  }
}

void set_source(cairo_t* cairo, const Rgb& colour) {
  cairo_set_source_rgb(cairo, colour[0] / 255.0, colour[1] / 255.0, colour[2] / 255.0);
}

int64_t text_width(const std::string& text, const TextStyle& style) {
  return static_cast<int64_t>(std::ceil(text_extent(text, font_of(style)).width));
}

void draw_text(Image& image, int64_t x, int64_t y, const std::string& text, const TextStyle& style) {
  const TextExtent extent = text_extent(text, font_of(style));
  const int64_t baseline = y + style.size * 19 / 20;
  // Accents and tall scripts reach over their line; the edges of letters may be spread over one more pixel.
  const int64_t left = x + static_cast<int64_t>(std::floor(extent.left)) - 1;
  const int64_t right = x + static_cast<int64_t>(std::ceil(extent.right)) + 1;
  const int64_t top = baseline + static_cast<int64_t>(std::floor(extent.top)) - 1;
  const int64_t bottom = baseline + static_cast<int64_t>(std::ceil(extent.bottom)) + 1;
  const PixelRect rect{left, top, right - left, bottom - top};
  paint_with_cairo(image, rect, [&](cairo_t* cairo) {
    set_source(cairo, style.colour);
    show_text(cairo, static_cast<double>(x), static_cast<double>(baseline), text, font_of(style));
  });
}

std::string fitted_text(const std::string& text, int64_t width, const TextStyle& style) {
  return shortened_text(text, static_cast<double>(width), font_of(style));
}

}  // namespace gld
