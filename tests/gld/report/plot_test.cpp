#include "gld/report/plot.h"

#include "gld/base/atomic_file.h"
#include "gld/report/plot_axis.h"
#include "gld/report/table.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

Figure example() {
  PlotPanel panel;
  panel.title = "panel";
  panel.x = {"x", AxisScale::kLog, 0, 0};
  panel.y = {"y", AxisScale::kLog, 0, 0};
  panel.series = {{"a", SeriesStyle::kLine, {{1, 1e-3}, {10, 1e-4}, {kNan, 1}, {100, -1}}},
                  {"b", SeriesStyle::kMarkers, {{3, 5e-2}}},
                  {"front", SeriesStyle::kFront, {{1, 1e-3}, {10, 1e-4}}},
                  {"level", SeriesStyle::kLevel, {{1, 1e-2}, {100, 1e-2}}}};
  return {"figure", {panel, panel}, 300, 260};
}

// Reads width and height in a PNG's header.
std::pair<int, int> png_size(const std::string& bytes) {
  const auto number = [&](size_t at) {
    int value = 0;
    for (size_t i = 0; i < 4; ++i) value = value * 256 + static_cast<unsigned char>(bytes[at + i]);
    return value;
  };
  return {number(16), number(20)};
}

TEST(Plot, WritesTheSameFigureAsSvgAndPng) {
  const test::TemporaryFolder folder;
  write_svg(example(), folder.path() / "plot.svg");
  write_png(example(), folder.path() / "plot.png");
  const auto svg = read_file(folder.path() / "plot.svg"), png = read_file(folder.path() / "plot.png");
  EXPECT_THAT(svg, testing::HasSubstr("<svg"));
  EXPECT_THAT(svg, testing::HasSubstr("</svg>"));
  EXPECT_EQ(png.substr(1, 3), "PNG");
  EXPECT_GT(png_size(png).first, 2 * 600);  // two panels and a legend, at two pixels a unit
  EXPECT_EQ(png_size(png).second, 2 * 260);
  write_png(example(), folder.path() / "again.png");
  EXPECT_EQ(png, read_file(folder.path() / "again.png"));
}

TEST(Plot, RefusesFiguresWithNothingToShow) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "plot.svg";
  EXPECT_EQ(error_of([&] { write_svg({}, file); }),
            file.string() + ": expected a figure with a panel, found none.");
  auto figure = example();
  figure.panels[0].series = {{"a", SeriesStyle::kLine, {{-1, 2}}}};
  EXPECT_EQ(error_of([&] { write_svg(figure, file); }),
            "plot panel, x: expected a finite value above 0 to plot, found none.");
  EXPECT_FALSE(std::filesystem::exists(file));
}

TEST(PlotAxis, LogTicksAreDecadesOrPlainNumbers) {
  const AxisLayout decades({"x", AxisScale::kLog, 1e-6, 1}, {}, "plot");
  std::vector<std::string> exponents;
  for (const auto& tick : decades.ticks()) {
    if (!tick.label.empty()) exponents.push_back(tick.label + "^" + tick.exponent);
  }
  EXPECT_THAT(exponents, testing::ElementsAre("10^-6", "10^-5", "10^-4", "10^-3", "10^-2", "10^-1", "10^0"));
  const AxisLayout narrow({"x", AxisScale::kLog, 4, 60}, {}, "plot");
  std::vector<std::string> labels;
  for (const auto& tick : narrow.ticks()) {
    if (!tick.label.empty()) labels.push_back(tick.label);
  }
  EXPECT_THAT(labels, testing::ElementsAre("5", "10", "20", "50"));
  EXPECT_NEAR(decades.position(1e-3), 0.5, 1e-12);
  EXPECT_FALSE(decades.shows(0));
  EXPECT_FALSE(decades.shows(kNan));
  EXPECT_FALSE(decades.shows(2));
}

TEST(PlotAxis, LinearTicksAreRound) {
  const AxisLayout axis({"x", AxisScale::kLinear, 0, 10}, {}, "plot");
  std::vector<std::string> labels;
  for (const auto& tick : axis.ticks()) labels.push_back(tick.label);
  EXPECT_THAT(labels, testing::ElementsAre("0", "2", "4", "6", "8", "10"));
  // Equal values still make an axis.
  EXPECT_TRUE(AxisLayout({"x", AxisScale::kLinear, 0, 0}, {3, 3}, "plot").shows(3));
  EXPECT_TRUE(AxisLayout({"x", AxisScale::kLog, 0, 0}, {3, 3}, "plot").shows(3));
  // So do values that differ by rounding alone, between which no step moves.
  double next = 12.3;
  for (int i = 0; i < 3; ++i) {
    next = std::nextafter(next, 13.0);
    EXPECT_LE(AxisLayout({"x", AxisScale::kLinear, 0, 0}, {12.3, next}, "plot").ticks().size(), 12U);
  }
  const AxisLayout across_zero({"x", AxisScale::kLinear, -0.4, 2}, {}, "plot");
  for (const auto& tick : across_zero.ticks()) EXPECT_NE(tick.label, "-0");
}

TEST(Plot, ParetoFrontKeepsWhatNothingBeats) {
  using Points = std::vector<std::pair<double, double>>;
  EXPECT_EQ(pareto_front({{3, 1}, {1, 5}, {2, 5}, {2, 3}, {4, 2}, {kNan, 0}}),
            (Points{{1, 5}, {2, 3}, {3, 1}}));
  EXPECT_EQ(pareto_front({}), Points{});
}

TEST(Table, WritesCsvAndMarkdown) {
  Table table({"name", "count", "error"});
  table.add_row({std::string("a, \"b\""), int64_t{3}, 0.1});
  table.add_row({std::string("c|d"), int64_t{40}, kNan});
  EXPECT_EQ(table.csv(), "name,count,error\n\"a, \"\"b\"\"\",3,0.1\nc|d,40,nan\n");
  EXPECT_EQ(table.markdown(),
            "| name   | count | error |\n"
            "| ------ | ----: | ----: |\n"
            "| a, \"b\" |     3 |   0.1 |\n"
            "| c\\|d   |    40 |   nan |\n");
  EXPECT_EQ(error_of([&] { table.add_row({int64_t{1}}); }), "table: expected 3 cells in a row, found 1.");
}

TEST(Table, NumbersReadBackExactly) {
  Table table({"value"});
  table.add_row({1.0 / 3});
  EXPECT_EQ(std::stod(table.csv().substr(6)), 1.0 / 3);
  EXPECT_EQ(short_number(0.0123456), "0.0123");
  EXPECT_EQ(short_number(1.5e-7), "1.5e-07");
}

}  // namespace
}  // namespace gld
