#pragma once

#include <cstdint>
#include <string>
#include <vector>

using cairo_t = struct _cairo;  // NOLINT(bugprone-reserved-identifier): the name is cairo's

namespace gld {

enum class TextWeight { kRegular, kBold };

struct TextFont {
  double size = 12.5;  // of an em, in units of the cairo context
  TextWeight weight = TextWeight::kRegular;
};

// Text on plots and pictures is drawn by Pango: it finds, character by character, an installed font that has it, and
// joins and orders the letters of scripts that need that, which cairo's own text cannot. Texts are single lines of
// UTF-8. What no installed font has, control characters and bytes that are no UTF-8 are drawn as code points: "U+6F22",
// "U+FFFD".

// How far the text reaches; x to the right and y down from the left end of its baseline.
struct TextExtent {
  double width = 0;  // to where a text behind it would start
  // Of what is painted; empty where nothing is.
  double left = 0, top = 0, right = 0, bottom = 0;
};
TextExtent text_extent(const std::string& text, const TextFont& font);

// Paints the text with the context's source; (x, y) is the left end of its baseline.
void show_text(cairo_t* cairo, double x, double y, const std::string& text, const TextFont& font);

// Returns the text with code points for what cannot be drawn, as both functions above take it.
std::string drawable_text(const std::string& text, const TextFont& font);

// Returns the text where it is at most that wide; otherwise its middle is left out ("corridor_…_0012"), since the ends
// are what tells names apart. Characters with their accents stay whole. The result is empty where not even "…" fits.
std::string shortened_text(const std::string& text, double width, const TextFont& font);

}  // namespace gld
