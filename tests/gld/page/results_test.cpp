#include "gld/page/results.h"

#include "gld/base/atomic_file.h"
#include "tests/support/not_finite.h"
#include "tests/support/temporary_folder.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

TEST(Results, HoldTablesCurvesAndPicturesInOrder) {
  test::TemporaryFolder run;
  const std::string png = std::string("\x89PNG\r\n\x1a\n", 8) + "rest";
  write_file_atomically(run.path() / "a.png", png);
  write_file_atomically(run.path() / "b.png", "<html>");
  Page page = results_page("gld eval", {{"warnings", {"a doubt"}}});
  add_table(page, {"Metrics", "a hint", {"metric", "mean"}, {{"psnr", "21.3"}}});
  add_table(page, {"Empty", "", {"metric"}, {}});
  PlotPanel panel;
  panel.title = "Losses";
  panel.x.label = "step";
  panel.y.scale = AxisScale::kLog;
  panel.series = {{"loss", SeriesStyle::kLine, {{1, 2}, {2, 0}, {3, test::kNan}, {4, 0.5}}},
                  {"one point", SeriesStyle::kLine, {{1, 2}}}};
  add_charts(page, "How it went", {panel, PlotPanel()});
  add_charts(page, "Nothing", {PlotPanel()});
  add_pictures(page, "Pictures", "", run.path(), {{"A", "a.png"}, {"B", "b.png"}, {"C", "c.png"}});
  add_pictures(page, "None", "", run.path(), {});
  add_fact(page, "Seed", "3");
  add_fact(page, "Nothing", "");
  const auto& parts = page.data.at("parts");
  ASSERT_EQ(parts.size(), 3u);
  EXPECT_EQ(
      parts[0].dump(),
      "{\"type\":\"table\",\"title\":\"Metrics\",\"hint\":\"a hint\",\"columns\":[\"metric\",\"mean\"],\"rows\":[[\"psnr\",\"21.3\"]]}");
  EXPECT_EQ(
      parts[1].at("charts").dump(),
      "[{\"title\":\"Losses\",\"x\":\"step\",\"y\":\"\",\"logarithmic\":true,\"series\":[{\"name\":\"loss\",\"points\":[[1.0,2.0],"
      "[2.0,null],[3.0,null],[4.0,0.5]]}]}]");
  EXPECT_EQ(parts[2].at("pictures").dump(),
            "[{\"name\":\"A\",\"address\":\"data:image/png;base64,iVBORw0KGgpyZXN0\"}]");
  EXPECT_THAT(
      page.doubts,
      ElementsAre("A doubt.", "b.png is left out of this page: expected a PNG file, found another one.",
                  "c.png is left out of this page: the file is missing."));
  EXPECT_EQ(page.data.at("facts").dump(), "[[\"Seed\",\"3\"]]");
  EXPECT_THAT(page_html(page), HasSubstr("\"kind\":\"results\""));
}

}  // namespace
}  // namespace gld
