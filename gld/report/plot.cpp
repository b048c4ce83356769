#include "gld/report/plot.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/report/cairo_text.h"
#include "gld/report/plot_axis.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include <cairo-svg.h>
#include <cairo.h>

namespace gld {
namespace {

struct Colour {
  double red, green, blue;
};

// Distinguishable by colour-blind readers (Okabe and Ito), then darker variants.
constexpr std::array<Colour, 14> kColours{{{0.00, 0.45, 0.70},
                                           {0.84, 0.37, 0.00},
                                           {0.00, 0.62, 0.45},
                                           {0.80, 0.47, 0.65},
                                           {0.90, 0.62, 0.00},
                                           {0.34, 0.71, 0.91},
                                           {0.35, 0.35, 0.35},
                                           {0.55, 0.10, 0.20},
                                           {0.40, 0.30, 0.70},
                                           {0.45, 0.45, 0.00},
                                           {0.00, 0.35, 0.35},
                                           {0.70, 0.55, 0.40},
                                           {0.05, 0.05, 0.05},
                                           {0.55, 0.80, 0.20}}};
constexpr Colour kInk{0.13, 0.13, 0.13}, kGrid{0.88, 0.88, 0.88}, kMinorGrid{0.95, 0.95, 0.95},
    kFrontGrey{0.45, 0.45, 0.45};
constexpr double kMarkerRadius = 3.6, kTextSize = 12.5;
constexpr int kMarkerShapes = 5;

struct Box {
  double left, top, right, bottom;
};

enum class Align { kLeft, kCentre, kRight };

class Canvas {
 public:
  explicit Canvas(cairo_surface_t* surface) : cairo_(cairo_create(surface), cairo_destroy) {
    set({1, 1, 1});
    cairo_paint(get());
  }
  cairo_t* get() const { return cairo_.get(); }
  void set(const Colour& c) { cairo_set_source_rgb(get(), c.red, c.green, c.blue); }

  void line(double x0, double y0, double x1, double y1, double width) {
    cairo_set_line_width(get(), width);
    cairo_move_to(get(), x0, y0);
    cairo_line_to(get(), x1, y1);
    cairo_stroke(get());
  }
  static double text_width(const std::string& text, double size) { return text_extent(text, {size}).width; }
  void text(double x, double y, const std::string& text, double size, Align align) {
    const double width = text_width(text, size);
    const double left = x - (align == Align::kLeft ? 0 : align == Align::kCentre ? width / 2 : width);
    show_text(get(), left, y, text, {size});
  }
  void marker(double x, double y, int shape) {
    constexpr double r = kMarkerRadius;
    cairo_new_path(get());
    switch (shape) {
      case 0:
        cairo_arc(get(), x, y, r, 0, 2 * M_PI);
        break;
      case 1:
        cairo_rectangle(get(), x - 0.9 * r, y - 0.9 * r, 1.8 * r, 1.8 * r);
        break;
      case 2:
        polygon({{x, y - 1.25 * r}, {x + 1.15 * r, y + 0.8 * r}, {x - 1.15 * r, y + 0.8 * r}});
        break;
      case 3:
        polygon({{x, y - 1.3 * r}, {x + 1.3 * r, y}, {x, y + 1.3 * r}, {x - 1.3 * r, y}});
        break;
      default:
        polygon({{x, y + 1.25 * r}, {x + 1.15 * r, y - 0.8 * r}, {x - 1.15 * r, y - 0.8 * r}});
        break;
    }
    cairo_fill(get());
  }

 private:
  void polygon(const std::vector<std::pair<double, double>>& corners) {
    for (const auto& corner : corners) cairo_line_to(get(), corner.first, corner.second);
    cairo_close_path(get());
  }
  std::unique_ptr<cairo_t, decltype(&cairo_destroy)> cairo_;
};

// Returns the names of the legend in order of first appearance; the index gives colour and marker.
std::vector<PlotSeries> legend_entries(const Figure& figure) {
  std::vector<PlotSeries> entries;
  for (const auto& panel : figure.panels) {
    for (const auto& series : panel.series) {
      const bool known = std::any_of(entries.begin(), entries.end(),
                                     [&](const PlotSeries& entry) { return entry.name == series.name; });
      if (!known && !series.name.empty()) entries.push_back({series.name, series.style, {}});
    }
  }
  return entries;
}

size_t style_index(const std::vector<PlotSeries>& entries, const std::string& name) {
  size_t index = 0;
  for (const auto& entry : entries) {
    if (entry.name == name) return index;
    if (entry.style == SeriesStyle::kLine || entry.style == SeriesStyle::kMarkers) ++index;
  }
  return index;
}

class PanelPainter {
 public:
  PanelPainter(Canvas& canvas, const PlotPanel& panel, const Box& box)
      : canvas_(canvas),
        panel_(panel),
        box_(box),
        x_(panel.x, coordinates(panel, &std::pair<double, double>::first), "plot " + panel.title + ", x"),
        y_(panel.y, coordinates(panel, &std::pair<double, double>::second), "plot " + panel.title + ", y") {}

  void paint(const std::vector<PlotSeries>& entries) {
    paint_grid();
    cairo_save(canvas_.get());
    cairo_rectangle(canvas_.get(), box_.left - 5, box_.top - 5, box_.right - box_.left + 10,
                    box_.bottom - box_.top + 10);
    cairo_clip(canvas_.get());
    for (const auto& series : panel_.series) paint_series(series, style_index(entries, series.name));
    cairo_restore(canvas_.get());
    paint_frame();
  }

 private:
  static std::vector<double> coordinates(const PlotPanel& panel,
                                         double std::pair<double, double>::*coordinate) {
    std::vector<double> values;
    for (const auto& series : panel.series) {
      for (const auto& point : series.points) values.push_back(point.*coordinate);
    }
    return values;
  }
  double column(double value) const { return box_.left + x_.position(value) * (box_.right - box_.left); }
  double row(double value) const { return box_.bottom - y_.position(value) * (box_.bottom - box_.top); }

  void tick_label(double x, double y, const AxisTick& tick, Align align) {
    if (tick.exponent.empty()) {
      canvas_.text(x, y, tick.label, kTextSize, align);
      return;
    }
    const double base = canvas_.text_width(tick.label, kTextSize);
    const double raised = canvas_.text_width(tick.exponent, kTextSize * 0.75);
    const double left = align == Align::kCentre ? x - (base + raised) / 2 : x - base - raised;
    canvas_.text(left, y, tick.label, kTextSize, Align::kLeft);
    canvas_.text(left + base, y - 5, tick.exponent, kTextSize * 0.75, Align::kLeft);
  }

  void paint_grid() {
    for (const bool labelled : {false, true}) {
      canvas_.set(labelled ? kGrid : kMinorGrid);
      for (const auto& tick : x_.ticks()) {
        if (tick.label.empty() == labelled) continue;
        canvas_.line(column(tick.value), box_.top, column(tick.value), box_.bottom, 1);
      }
      for (const auto& tick : y_.ticks()) {
        if (tick.label.empty() == labelled) continue;
        canvas_.line(box_.left, row(tick.value), box_.right, row(tick.value), 1);
      }
    }
  }

  void paint_frame() {
    canvas_.set(kInk);
    cairo_set_line_width(canvas_.get(), 1);
    cairo_rectangle(canvas_.get(), box_.left, box_.top, box_.right - box_.left, box_.bottom - box_.top);
    cairo_stroke(canvas_.get());
    for (const auto& tick : x_.ticks()) {
      if (!tick.label.empty()) tick_label(column(tick.value), box_.bottom + 18, tick, Align::kCentre);
    }
    for (const auto& tick : y_.ticks()) {
      if (!tick.label.empty()) tick_label(box_.left - 7, row(tick.value) + 4.5, tick, Align::kRight);
    }
    const double middle = (box_.left + box_.right) / 2;
    canvas_.text(middle, box_.bottom + 40, panel_.x.label, kTextSize + 0.5, Align::kCentre);
    canvas_.text(middle, box_.top - 10, panel_.title, kTextSize + 1, Align::kCentre);
    cairo_save(canvas_.get());
    cairo_translate(canvas_.get(), box_.left - 52, (box_.top + box_.bottom) / 2);
    cairo_rotate(canvas_.get(), -M_PI / 2);
    canvas_.text(0, 0, panel_.y.label, kTextSize + 0.5, Align::kCentre);
    cairo_restore(canvas_.get());
  }

  void paint_series(const PlotSeries& series, size_t index) {
    std::vector<std::pair<double, double>> shown;
    for (const auto& point : series.points) {
      if (x_.shows(point.first) && y_.shows(point.second))
        shown.emplace_back(column(point.first), row(point.second));
    }
    auto* cairo = canvas_.get();
    cairo_new_path(cairo);
    if (series.style == SeriesStyle::kFront) {
      paint_front(shown);
      return;
    }
    canvas_.set(series.style == SeriesStyle::kLevel ? kInk : kColours[index % kColours.size()]);
    if (series.style != SeriesStyle::kMarkers) {
      constexpr double kDots[] = {2, 3};
      if (series.style == SeriesStyle::kLevel) cairo_set_dash(cairo, kDots, 2, 0);
      cairo_set_line_width(cairo, 1.6);
      for (const auto& point : shown) cairo_line_to(cairo, point.first, point.second);
      cairo_stroke(cairo);
      cairo_set_dash(cairo, nullptr, 0, 0);
    }
    if (series.style == SeriesStyle::kLevel) return;
    for (const auto& point : shown) {
      canvas_.marker(point.first, point.second, static_cast<int>(index) % kMarkerShapes);
    }
  }

  void paint_front(const std::vector<std::pair<double, double>>& shown) {
    auto* cairo = canvas_.get();
    canvas_.set(kFrontGrey);
    constexpr double kDashes[] = {6, 4};
    cairo_set_dash(cairo, kDashes, 2, 0);
    cairo_set_line_width(cairo, 1.4);
    for (size_t i = 0; i < shown.size(); ++i) {
      if (i > 0) cairo_line_to(cairo, shown[i].first, shown[i - 1].second);
      cairo_line_to(cairo, shown[i].first, shown[i].second);
    }
    cairo_stroke(cairo);
    cairo_set_dash(cairo, nullptr, 0, 0);
    for (const auto& point : shown) {
      cairo_new_sub_path(cairo);
      cairo_arc(cairo, point.first, point.second, 7, 0, 2 * M_PI);
      cairo_stroke(cairo);
    }
  }

  Canvas& canvas_;
  const PlotPanel& panel_;
  Box box_;
  AxisLayout x_;
  AxisLayout y_;
};

void paint_legend(Canvas& canvas, const std::vector<PlotSeries>& entries, double left, double top) {
  double y = top + 12;
  for (const auto& entry : entries) {
    const size_t index = style_index(entries, entry.name);
    auto* cairo = canvas.get();
    cairo_new_path(cairo);
    constexpr double kDashes[] = {6, 4}, kDots[] = {2, 3};
    const double middle = y - 4.5;
    if (entry.style == SeriesStyle::kFront || entry.style == SeriesStyle::kLevel) {
      canvas.set(entry.style == SeriesStyle::kFront ? kFrontGrey : kInk);
      cairo_set_dash(cairo, entry.style == SeriesStyle::kFront ? kDashes : kDots, 2, 0);
      canvas.line(left, middle, left + 26, middle, 1.5);
      cairo_set_dash(cairo, nullptr, 0, 0);
    } else {
      canvas.set(kColours[index % kColours.size()]);
      if (entry.style == SeriesStyle::kLine) canvas.line(left, middle, left + 26, middle, 1.6);
      canvas.marker(left + 13, middle, static_cast<int>(index) % kMarkerShapes);
    }
    canvas.set(kInk);
    canvas.text(left + 33, y, entry.name, kTextSize, Align::kLeft);
    y += 19;
  }
}

using Surface = std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)>;

struct FigureSize {
  double width, height, legend;
};

constexpr double kTop = 62, kLeft = 72, kRight = 18, kBottom = 56;

FigureSize figure_size(const Figure& figure, const std::vector<PlotSeries>& entries) {
  double longest = 0;
  for (const auto& entry : entries) longest = std::max(longest, Canvas::text_width(entry.name, kTextSize));
  const double legend = entries.empty() ? 0 : 4 + 33 + longest + 16;
  const double panels = static_cast<double>(figure.panels.size()) * static_cast<double>(figure.panel_width);
  const double rows = kTop + 19 * static_cast<double>(entries.size()) + 20;
  return {std::ceil(panels + legend), std::max(static_cast<double>(figure.height), rows), legend};
}

void paint_figure(const Figure& figure, const FigureSize& size, const std::vector<PlotSeries>& entries,
                  cairo_surface_t* surface) {
  Canvas canvas(surface);
  canvas.set(kInk);
  const double panels = size.width - size.legend;
  canvas.text(panels / 2 + (kLeft - kRight) / 2, 26, figure.title, kTextSize + 4, Align::kCentre);
  for (size_t i = 0; i < figure.panels.size(); ++i) {
    const double left = static_cast<double>(i) * static_cast<double>(figure.panel_width);
    const Box box{left + kLeft, kTop, left + static_cast<double>(figure.panel_width) - kRight,
                  size.height - kBottom};
    PanelPainter(canvas, figure.panels[i], box).paint(entries);
  }
  paint_legend(canvas, entries, panels + 4, kTop);
}

cairo_status_t append(void* closure, const unsigned char* data, unsigned int length) {
  static_cast<std::string*>(closure)->append(reinterpret_cast<const char*>(data), length);
  return CAIRO_STATUS_SUCCESS;
}

void require_drawn(cairo_status_t status, const std::filesystem::path& file) {
  if (status != CAIRO_STATUS_SUCCESS) {
    fail({file.string(), "cairo to draw the figure", cairo_status_to_string(status), ""});
  }
}

void require_panels(const Figure& figure, const std::filesystem::path& file) {
  if (figure.panels.empty()) fail({file.string(), "a figure with a panel", "none", ""});
}

}  // namespace

void write_svg(const Figure& figure, const std::filesystem::path& file) {
  require_panels(figure, file);
  const auto entries = legend_entries(figure);
  const auto size = figure_size(figure, entries);
  std::string bytes;
  {
    const Surface surface(cairo_svg_surface_create_for_stream(append, &bytes, size.width, size.height),
                          cairo_surface_destroy);
    paint_figure(figure, size, entries, surface.get());
    cairo_surface_finish(surface.get());
    require_drawn(cairo_surface_status(surface.get()), file);
  }
  write_file_atomically(file, bytes);
}

void write_png(const Figure& figure, const std::filesystem::path& file) {
  require_panels(figure, file);
  const auto entries = legend_entries(figure);
  const auto size = figure_size(figure, entries);
  // The picture has twice the pixels, so that it stays sharp when it is enlarged.
  constexpr double kScale = 2;
  const Surface surface(cairo_image_surface_create(CAIRO_FORMAT_RGB24, static_cast<int>(kScale * size.width),
                                                   static_cast<int>(kScale * size.height)),
                        cairo_surface_destroy);
  cairo_surface_set_device_scale(surface.get(), kScale, kScale);
  paint_figure(figure, size, entries, surface.get());
  std::string bytes;
  require_drawn(cairo_surface_write_to_png_stream(surface.get(), append, &bytes), file);
  write_file_atomically(file, bytes);
}

std::vector<std::pair<double, double>> pareto_front(std::vector<std::pair<double, double>> points) {
  points.erase(
      std::remove_if(points.begin(), points.end(),
                     [](const auto& p) { return !std::isfinite(p.first) || !std::isfinite(p.second); }),
      points.end());
  std::sort(points.begin(), points.end());
  std::vector<std::pair<double, double>> front;
  for (const auto& point : points) {
    if (front.empty() || point.second < front.back().second) front.push_back(point);
  }
  return front;
}

}  // namespace gld
