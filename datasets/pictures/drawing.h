#pragma once

#include "datasets/images/image.h"
#include "datasets/pictures/colour_map.h"
#include "gld/report/cairo_text.h"

#include <cstdint>
#include <functional>
#include <string>

namespace gld {

// These functions do simple drawing on 8-bit images for previews and contact sheets. Everything is clipped to the
// image.

struct PixelRect {
  int64_t x = 0;
  int64_t y = 0;
  int64_t width = 0;
  int64_t height = 0;
};

struct TextStyle {
  int64_t size = 14;  // of an em, pixels
  Rgb colour{235, 235, 235};
  TextWeight weight = TextWeight::kRegular;
};

Image filled_image(int64_t width, int64_t height, const Rgb& colour);
void fill_rect(Image& image, const PixelRect& rect, const Rgb& colour);

// Copies picture with its top left corner at (x, y).
void paste(Image& image, const Image& picture, int64_t x, int64_t y);

// Returns the picture at another size: averaged when smaller, cubic when larger.
Image resized(const Image& picture, int64_t width, int64_t height);

// Paints with cairo on the part of the image inside rect; the context's unit is a pixel, its origin the image's top
// left corner. paint must not fail.
void paint_with_cairo(Image& image, const PixelRect& rect, const std::function<void(cairo_t*)>& paint);
void set_source(cairo_t* cairo, const Rgb& colour);

// Texts are UTF-8 in any script that an installed font has; the rest is drawn as code points (gld/report/cairo_text.h).
int64_t text_width(const std::string& text, const TextStyle& style);

// y is the top of a line of the style's size.
void draw_text(Image& image, int64_t x, int64_t y, const std::string& text, const TextStyle& style);

// Returns the text, without its middle where it is wider than that.
std::string fitted_text(const std::string& text, int64_t width, const TextStyle& style);

}  // namespace gld
