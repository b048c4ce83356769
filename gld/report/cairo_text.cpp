#include "gld/report/cairo_text.h"

#include <algorithm>
#include <memory>
#include <string_view>

#include <fmt/format.h>
#include <pango/pangocairo.h>

namespace gld {
namespace {

constexpr uint32_t kReplacement = 0xFFFD;  // Unicode's character for bytes that are no character
const char* const kEllipsis = "…";

struct Unref {
  void operator()(void* object) const { g_object_unref(object); }
};
using Layout = std::unique_ptr<PangoLayout, Unref>;

// The layout has grey edges and whole-pixel advances, whatever the desktop says about its screen.
Layout make_layout(const TextFont& font) {
  const std::unique_ptr<PangoContext, Unref> context(
      pango_font_map_create_context(pango_cairo_font_map_get_default()));
  pango_cairo_context_set_resolution(context.get(), 72);
  const std::unique_ptr<cairo_font_options_t, decltype(&cairo_font_options_destroy)> options(
      cairo_font_options_create(), cairo_font_options_destroy);
  cairo_font_options_set_antialias(options.get(), CAIRO_ANTIALIAS_GRAY);
  cairo_font_options_set_hint_style(options.get(), CAIRO_HINT_STYLE_SLIGHT);
  cairo_font_options_set_hint_metrics(options.get(), CAIRO_HINT_METRICS_ON);
  pango_cairo_context_set_font_options(context.get(), options.get());
  const std::unique_ptr<PangoFontDescription, decltype(&pango_font_description_free)> description(
      pango_font_description_new(), pango_font_description_free);
  pango_font_description_set_family_static(description.get(), "sans-serif");
  pango_font_description_set_absolute_size(description.get(), font.size * PANGO_SCALE);
  pango_font_description_set_weight(
      description.get(), font.weight == TextWeight::kBold ? PANGO_WEIGHT_BOLD : PANGO_WEIGHT_NORMAL);
  Layout layout(pango_layout_new(context.get()));
  pango_layout_set_font_description(layout.get(), description.get());
  pango_layout_set_single_paragraph_mode(layout.get(), TRUE);
  return layout;
}

struct Character {
  uint32_t code = 0;
  std::string_view bytes;
};

std::vector<Character> characters(const std::string& text) {
  std::vector<Character> result;
  for (size_t at = 0; at < text.size();) {
    const char* start = text.data() + at;
    const gunichar code = g_utf8_get_char_validated(start, static_cast<gssize>(text.size() - at));
    // The two values that are not characters also cover a zero byte, after which Pango would stop.
    const bool valid = code != static_cast<gunichar>(-1) && code != static_cast<gunichar>(-2) && *start != 0;
    const size_t length = valid ? static_cast<size_t>(g_utf8_next_char(start) - start) : 1;
    result.push_back({valid ? code : kReplacement, std::string_view(start, length)});
    at += length;
  }
  return result;
}

// Returns the byte offsets of the characters that no installed font has.
std::vector<size_t> missing_characters(PangoLayout* layout) {
  std::vector<size_t> missing;
  if (pango_layout_get_unknown_glyphs_count(layout) == 0) return missing;
  const std::unique_ptr<PangoLayoutIter, decltype(&pango_layout_iter_free)> iterator(
      pango_layout_get_iter(layout), pango_layout_iter_free);
  do {
    const PangoLayoutRun* run = pango_layout_iter_get_run_readonly(iterator.get());
    if (run == nullptr) continue;  // the end of a line
    for (int i = 0; i < run->glyphs->num_glyphs; ++i) {
      const PangoGlyph glyph = run->glyphs->glyphs[i].glyph;
      if ((glyph & PANGO_GLYPH_UNKNOWN_FLAG) == 0 || glyph == PANGO_GLYPH_EMPTY) continue;
      missing.push_back(static_cast<size_t>(run->item->offset + run->glyphs->log_clusters[i]));
    }
  } while (pango_layout_iter_next_run(iterator.get()) != 0);
  std::sort(missing.begin(), missing.end());
  return missing;
}

std::string with_code_points(const std::vector<Character>& text, const std::vector<size_t>& missing) {
  std::string result;
  size_t at = 0;
  bool after_code_point = false;
  for (const Character& character : text) {
    const bool known = !std::binary_search(missing.begin(), missing.end(), at);
    if (known) {
      result += character.bytes;
    } else {
      result += fmt::format("{}U+{:04X}", after_code_point ? " " : "", character.code);
    }
    after_code_point = !known;
    at += character.bytes.size();
  }
  return result;
}

// Returns where the text may be cut: byte offsets from 0 to its end, a character with its accents between two of them.
std::vector<size_t> character_ends(const std::string& text, const TextFont& font) {
  const std::vector<Character> all = characters(text);
  std::string valid;
  for (const Character& character : all) {
    char bytes[6];
    valid.append(bytes, static_cast<size_t>(g_unichar_to_utf8(character.code, bytes)));
  }
  const Layout layout = make_layout(font);
  pango_layout_set_text(layout.get(), valid.data(), static_cast<int>(valid.size()));
  int count = 0;  // one more than characters
  const PangoLogAttr* attributes = pango_layout_get_log_attrs_readonly(layout.get(), &count);
  std::vector<size_t> ends;
  size_t at = 0;
  for (size_t i = 0; i < static_cast<size_t>(count); ++i) {
    if (attributes[i].is_cursor_position != 0) ends.push_back(at);
    if (i < all.size()) at += all[i].bytes.size();
  }
  return ends;
}

Layout drawable_layout(const std::string& text, const TextFont& font) {
  Layout layout = make_layout(font);
  const std::string drawable = drawable_text(text, font);
  pango_layout_set_text(layout.get(), drawable.data(), static_cast<int>(drawable.size()));
  return layout;
}

double baseline(PangoLayout* layout) {
  return static_cast<double>(pango_layout_get_baseline(layout)) / PANGO_SCALE;
}

double width_of(PangoLayout* layout) {
  PangoRectangle logical;
  pango_layout_get_extents(layout, nullptr, &logical);
  return static_cast<double>(logical.width) / PANGO_SCALE;
}

}  // namespace

std::string drawable_text(const std::string& text, const TextFont& font) {
  const std::vector<Character> all = characters(text);
  std::vector<size_t> not_printable;
  size_t at = 0;
  for (const Character& character : all) {
    const bool broken = character.code == kReplacement;
    if (broken || g_unichar_iscntrl(character.code) != 0) not_printable.push_back(at);
    at += character.bytes.size();
  }
  const std::string printable = with_code_points(all, not_printable);
  const Layout layout = make_layout(font);
  pango_layout_set_text(layout.get(), printable.data(), static_cast<int>(printable.size()));
  const std::vector<size_t> missing = missing_characters(layout.get());
  return missing.empty() ? printable : with_code_points(characters(printable), missing);
}

TextExtent text_extent(const std::string& text, const TextFont& font) {
  const Layout layout = drawable_layout(text, font);
  PangoRectangle ink;
  pango_layout_get_extents(layout.get(), &ink, nullptr);
  const auto units = [](int value) { return static_cast<double>(value) / PANGO_SCALE; };
  const double line = baseline(layout.get());
  TextExtent extent;
  extent.width = width_of(layout.get());
  extent.left = units(ink.x);
  extent.top = units(ink.y) - line;
  extent.right = units(ink.x + ink.width);
  extent.bottom = units(ink.y + ink.height) - line;
  return extent;
}

void show_text(cairo_t* cairo, double x, double y, const std::string& text, const TextFont& font) {
  const Layout layout = drawable_layout(text, font);
  pango_cairo_update_layout(cairo, layout.get());
  cairo_move_to(cairo, x, y - baseline(layout.get()));
  pango_cairo_show_layout(cairo, layout.get());
  cairo_new_path(cairo);
}

std::string shortened_text(const std::string& text, double width, const TextFont& font) {
  const auto fits = [&](const std::string& candidate) { return text_extent(candidate, font).width <= width; };
  if (fits(text)) return text;
  if (!fits(kEllipsis)) return "";
  const std::vector<size_t> cuts = character_ends(text, font);
  // The end gets the odd character: there the number is.
  const auto with_kept = [&](size_t kept) {
    const size_t beginning = cuts[kept / 2], end = cuts[cuts.size() - 1 - (kept - kept / 2)];
    return text.substr(0, beginning) + kEllipsis + text.substr(end);
  };
  size_t fitting = 0, too_many = cuts.size() - 1;
  while (fitting + 1 < too_many) {
    const size_t middle = (fitting + too_many) / 2;
    (fits(with_kept(middle)) ? fitting : too_many) = middle;
  }
  return with_kept(fitting);
}

}  // namespace gld
