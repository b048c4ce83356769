#include "datasets/pictures/contact_sheet.h"

#include "datasets/pictures/drawing.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <deque>

namespace gld {
namespace {

constexpr Rgb kPaper{30, 32, 36};
constexpr Rgb kEmptyCell{42, 45, 50};
constexpr Rgb kSheetInk{236, 238, 242};
constexpr Rgb kFaintInk{164, 170, 180};
constexpr Rgb kSourceAccent{86, 180, 233};  // colours that also the colour-blind tell apart (Okabe and Ito)
constexpr Rgb kTargetAccent{230, 159, 0};

constexpr int64_t kSheetMargin = 24;
constexpr int64_t kLabelColumn = 88;
constexpr int64_t kGap = 8;        // between pictures
constexpr int64_t kBandGap = 14;   // between the lines of a section
constexpr int64_t kNameLine = 22;  // the view's name above its pictures
constexpr int64_t kHeading = 40;
constexpr int64_t kTitle = 34;
constexpr int64_t kSubtitle = 24;
constexpr int64_t kLegend = 52;
constexpr int64_t kNarrowestColumn = 84;
constexpr double kSmallestSide = 160;  // of the longer side of a picture

struct Row {
  std::string label;
  Image SheetView::*picture;
};

struct Section {
  std::string heading;
  Rgb accent{};
  std::vector<const SheetView*> views;
  std::vector<Row> rows;
};

struct Layout {
  int64_t labels = 0;  // width of the column at the left that says what rows are
  int64_t columns = 1;
  int64_t pitch = 0;  // width of a column without the gap
  int64_t picture_width = 0;
  int64_t picture_height = 0;
};

Section make_section(const std::vector<SheetView>& views, SheetRole role) {
  Section section;
  const bool source = role == SheetRole::kSource;
  for (const SheetView& view : views) {
    if (view.role == role) section.views.push_back(&view);
  }
  section.heading =
      (source ? "Source views (" : "Target views (") + std::to_string(section.views.size()) + ")";
  section.accent = source ? kSourceAccent : kTargetAccent;
  for (const Row& row : {Row{source ? "image" : "new view", &SheetView::image},
                         Row{"truth", &SheetView::truth}, Row{"depth", &SheetView::depth}}) {
    const bool wanted = std::any_of(section.views.begin(), section.views.end(),
                                    [&](const SheetView* view) { return !(view->*row.picture).empty(); });
    if (wanted) section.rows.push_back(row);
  }
  return section;
}

int64_t bands(const Section& section, int64_t columns) {
  return (static_cast<int64_t>(section.views.size()) + columns - 1) / columns;
}

int64_t header_height(const SheetText& text) {
  return (text.title.empty() ? 0 : kTitle) + static_cast<int64_t>(text.verdict.size()) * kSubtitle +
         (text.subtitle.empty() ? 0 : kSubtitle);
}

bool has_depth(const std::vector<Section>& sections) {
  return std::any_of(sections.begin(), sections.end(), [](const Section& section) {
    return std::any_of(section.rows.begin(), section.rows.end(),
                       [](const Row& row) { return row.picture == &SheetView::depth; });
  });
}

// The height of everything but the pictures, and the number of picture rows.
struct Overhead {
  int64_t pixels = 0;
  int64_t picture_rows = 0;
};

Overhead overhead(const std::vector<Section>& sections, const SheetText& text, int64_t columns) {
  Overhead result;
  result.pixels = 2 * kSheetMargin + header_height(text) + (has_depth(sections) ? kLegend : 0);
  for (const Section& section : sections) {
    const int64_t lines = bands(section, columns);
    const auto rows = static_cast<int64_t>(section.rows.size());
    result.pixels += kHeading + lines * (kNameLine + (rows - 1) * kGap + kBandGap);
    result.picture_rows += lines * rows;
  }
  return result;
}

double aspect_of(const std::vector<Section>& sections) {
  for (const Section& section : sections) {
    for (const SheetView* view : section.views) {
      for (const Image* picture : {&view->image, &view->truth, &view->depth}) {
        if (!picture->empty())
          return static_cast<double>(picture->width) / static_cast<double>(picture->height);
      }
    }
  }
  fail({"contact sheet", "at least one picture", "none", "decode images or depth"});
}

// Returns the number of columns that makes the pictures largest; of equals the one with fewest lines.
Layout choose_layout(const std::vector<Section>& sections, const SheetText& text, const SheetLimits& limits) {
  const double aspect = aspect_of(sections);
  Layout best;
  int64_t most = 1;
  for (const Section& section : sections) {
    most = std::max(most, static_cast<int64_t>(section.views.size()));
    for (const Row& row : section.rows) {
      if (!row.label.empty()) best.labels = kLabelColumn;
    }
  }
  double best_width = 0;
  for (int64_t columns = 1; columns <= most; ++columns) {
    const Overhead fixed = overhead(sections, text, columns);
    const int64_t across = limits.width - 2 * kSheetMargin - best.labels - (columns - 1) * kGap;
    const int64_t down = (limits.height - fixed.pixels) / fixed.picture_rows;
    const auto longest = static_cast<double>(limits.picture);
    double width = std::min(static_cast<double>(across) / static_cast<double>(columns),
                            static_cast<double>(down) * aspect);
    width = std::min({width, longest, longest * aspect});
    if (columns == 1 || width >= best_width) {
      best_width = std::max(width, 1.0);
      best.columns = columns;
    }
  }
  // Many views leave little room: pictures stay recognisable and the sheet grows instead.
  best_width = std::max(best_width, kSmallestSide * std::min(1.0, aspect));
  best.picture_width = std::max<int64_t>(1, static_cast<int64_t>(best_width));
  best.picture_height = std::max<int64_t>(1, std::llround(static_cast<double>(best.picture_width) / aspect));
  best.pitch = std::max(best.picture_width, kNarrowestColumn);
  return best;
}

// Places the picture inside its cell, as large as fits, centred.
void place_picture(Image& sheet, const Image& picture, const PixelRect& cell) {
  if (picture.empty()) {
    fill_rect(sheet, cell, kEmptyCell);
    const TextStyle style{13, kFaintInk, TextWeight::kRegular};
    const std::string text = fitted_text("none", cell.width, style);
    draw_text(sheet, cell.x + (cell.width - text_width(text, style)) / 2, cell.y + (cell.height - 13) / 2,
              text, style);
    return;
  }
  const double scale = std::min(static_cast<double>(cell.width) / static_cast<double>(picture.width),
                                static_cast<double>(cell.height) / static_cast<double>(picture.height));
  const auto fit = [&](int64_t side, int64_t room) {
    return std::clamp<int64_t>(std::llround(scale * static_cast<double>(side)), 1, room);
  };
  const int64_t width = fit(picture.width, cell.width);
  const int64_t height = fit(picture.height, cell.height);
  if (width != cell.width || height != cell.height) fill_rect(sheet, cell, kEmptyCell);
  paste(sheet, resized(picture, width, height), cell.x + (cell.width - width) / 2,
        cell.y + (cell.height - height) / 2);
}

void draw_name(Image& sheet, const SheetView& view, const PixelRect& line) {
  const TextStyle name{14, kSheetInk, TextWeight::kRegular};
  const TextStyle note{13, kFaintInk, TextWeight::kRegular};
  const int64_t note_width = text_width(view.note, note);
  const int64_t beside_note = line.width - note_width - 8;
  // A long name makes room for the note where enough of it is left to tell it by.
  const int64_t name_room = beside_note >= line.width / 2 ? beside_note : line.width;
  const std::string shown = fitted_text(view.name, name_room, name);
  draw_text(sheet, line.x, line.y, shown, name);
  if (text_width(shown, name) <= beside_note) {
    draw_text(sheet, line.x + line.width - note_width, line.y, view.note, note);
  }
}

// Draws one section from y downwards; returns where it ends.
int64_t draw_section(Image& sheet, const Section& section, const Layout& layout, int64_t y) {
  fill_rect(sheet, {kSheetMargin, y + 6, 4, 22}, section.accent);
  draw_text(sheet, kSheetMargin + 12, y + 8, section.heading, {17, kSheetInk, TextWeight::kBold});
  y += kHeading;
  const auto count = static_cast<int64_t>(section.views.size());
  for (int64_t first = 0; first < count; first += layout.columns) {
    const int64_t last = std::min(first + layout.columns, count);
    for (int64_t i = first; i < last; ++i) {
      const SheetView& view = *section.views[static_cast<size_t>(i)];
      const int64_t name_x = kSheetMargin + layout.labels + (i - first) * (layout.pitch + kGap);
      const int64_t x = name_x + (layout.pitch - layout.picture_width) / 2;
      draw_name(sheet, view, {name_x, y, layout.pitch, kNameLine});
      for (size_t row = 0; row < section.rows.size(); ++row) {
        const int64_t top = y + kNameLine + static_cast<int64_t>(row) * (layout.picture_height + kGap);
        place_picture(sheet, view.*section.rows[row].picture,
                      {x, top, layout.picture_width, layout.picture_height});
      }
    }
    for (size_t row = 0; row < section.rows.size(); ++row) {
      const int64_t top = y + kNameLine + static_cast<int64_t>(row) * (layout.picture_height + kGap);
      draw_text(sheet, kSheetMargin, top + (layout.picture_height - 14) / 2, section.rows[row].label,
                {14, kFaintInk, TextWeight::kRegular});
    }
    const auto rows = static_cast<int64_t>(section.rows.size());
    y += kNameLine + rows * layout.picture_height + (rows - 1) * kGap + kBandGap;
  }
  return y;
}

Image draw_sheet(const std::vector<Section>& sections, const SheetText& text, const SheetLimits& limits) {
  const Layout layout = choose_layout(sections, text, limits);
  int64_t columns_used = 1;
  for (const Section& section : sections) {
    columns_used =
        std::max(columns_used, std::min(layout.columns, static_cast<int64_t>(section.views.size())));
  }
  const Overhead fixed = overhead(sections, text, layout.columns);
  const int64_t content = layout.labels + columns_used * (layout.pitch + kGap) - kGap;
  const TextStyle title{22, kSheetInk, TextWeight::kBold};
  const TextStyle subtitle{14, kFaintInk, TextWeight::kRegular};
  const TextStyle verdict{14, kSheetInk, TextWeight::kBold};
  int64_t widest_text = std::max(text_width(text.title, title), text_width(text.subtitle, subtitle));
  for (const std::string& line : text.verdict) widest_text = std::max(widest_text, text_width(line, verdict));
  const int64_t inner =
      std::max({content, std::min(widest_text, limits.width - 2 * kSheetMargin), int64_t{280}});
  const int64_t width = inner + 2 * kSheetMargin;
  Image sheet = filled_image(width, fixed.pixels + fixed.picture_rows * layout.picture_height, kPaper);

  int64_t y = kSheetMargin - 4;
  if (!text.title.empty()) {
    draw_text(sheet, kSheetMargin, y, fitted_text(text.title, inner, title), title);
    y += kTitle;
  }
  for (const std::string& line : text.verdict) {
    draw_text(sheet, kSheetMargin, y, fitted_text(line, inner, verdict), verdict);
    y += kSubtitle;
  }
  if (!text.subtitle.empty()) {
    draw_text(sheet, kSheetMargin, y, fitted_text(text.subtitle, inner, subtitle), subtitle);
    y += kSubtitle;
  }
  for (const Section& section : sections) y = draw_section(sheet, section, layout, y);
  if (has_depth(sections)) {
    draw_text(sheet, kSheetMargin, y + 10, "depth", {14, kFaintInk, TextWeight::kRegular});
    const int64_t legend_width = std::min<int64_t>(inner - kLabelColumn, 640);
    paste(sheet, depth_legend(text.depth_range, legend_width, text.depth_unit, kPaper),
          kSheetMargin + kLabelColumn - 12, y + 6);
  }
  return sheet;
}

}  // namespace

Image make_contact_sheet(const std::vector<SheetView>& views, const SheetText& text,
                         const SheetLimits& limits) {
  std::vector<Section> sections;
  for (const SheetRole role : {SheetRole::kSource, SheetRole::kTarget}) {
    Section section = make_section(views, role);
    if (!section.rows.empty()) sections.push_back(std::move(section));
  }
  return draw_sheet(sections, text, limits);
}

Image make_picture_sheet(const std::vector<SheetSection>& sections, const SheetText& text,
                         const SheetLimits& limits) {
  std::deque<SheetView> views;  // what the drawn sections point to must stay where it is
  std::vector<Section> drawn;
  for (const SheetSection& section : sections) {
    if (section.pictures.empty()) continue;
    drawn.push_back({section.heading, kFaintInk, {}, {{"", &SheetView::image}}});
    for (const auto& [name, picture] : section.pictures) {
      SheetView view;
      view.name = name;
      view.image = picture;
      views.push_back(std::move(view));
      drawn.back().views.push_back(&views.back());
    }
  }
  return draw_sheet(drawn, text, limits);
}

}  // namespace gld
