#include "infer/page/sample_page.h"

#include "gld/base/atomic_file.h"
#include "gld/base/json_text.h"
#include "gld/splatting/splat_ply.h"
#include "tests/support/drawn_run.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

test::DrawnRun small_run(int64_t width) {
  test::DrawnRun drawn;
  drawn.width = width;
  drawn.height = 40;
  return drawn;
}

class SamplePage : public testing::Test {
 protected:
  const std::filesystem::path& run() const { return temporary_.path(); }
  void write(const test::DrawnRun& drawn = {}) const { test::write_drawn_run(run(), drawn); }
  Page page(const PageOptions& options = {}) const { return sample_page(run(), options); }
  void change_json(const std::string& file,
                   const std::function<void(nlohmann::ordered_json&)>& change) const {
    auto json = parse_ordered_json(read_file(run() / file), file);
    change(json);
    write_file_atomically(run() / file, json_text(json));
  }

 private:
  test::TemporaryFolder temporary_;
};

TEST_F(SamplePage, ShowsWhatTheRunHas) {
  write(small_run(48));
  const Page made = page();
  EXPECT_EQ(made.heading, "New views of room");
  EXPECT_EQ(made.asked,
            "Asked for: 3 new views of room from 3 photographs at 48x40 pixels, by the model drawn.");
  EXPECT_EQ(made.verdict, "These pictures are drawn, and as good as the truth.");
  EXPECT_THAT(made.doubts, ElementsAre("The cameras of the photographs are not sure: a word & a <tag>."));
  const auto& views = made.data.at("views");
  ASSERT_EQ(views.size(), 6u);
  EXPECT_EQ(views[0].at("role"), "source");
  EXPECT_FALSE(views[0].contains("truth"));
  EXPECT_FALSE(views[0].contains("nearest"));
  EXPECT_EQ(views[4].at("psnr"), 36.1);
  EXPECT_EQ(views[4].at("file"), "images/view_04.png");
  // A source, the last of the given ones, stands before the first target on the path.
  EXPECT_EQ(views[3].at("nearest"), 2);
  // These pictures are 3 sources with depth, 3 targets with truth and depth.
  EXPECT_EQ(made.data.at("pictures").size(), 15u);
  EXPECT_NE(made.data.at("pictures")[views[4].at("picture").get<size_t>()],
            made.data.at("pictures")[views[4].at("truth").get<size_t>()]);
  EXPECT_EQ(made.data.at("cloud").at("of"), made.data.at("cloud").at("count"));
  EXPECT_GT(made.data.at("cloud").at("count").get<int>(), 6 * 48 * 40 / 2);
  EXPECT_EQ(made.data.at("cloud_note"), "");
  EXPECT_EQ(made.data.at("stages")[0].at("peak_bytes"), 123000000);
  EXPECT_EQ(made.data.at("command"), "gld sample --scene room");
  EXPECT_THAT(made.data.at("facts").dump(),
              AllOf(HasSubstr(std::string(64, 'a')), HasSubstr("[\"Seed\",\"7\"]")));
  // The provenance of the run's files: where it was written is not part of it.
  EXPECT_THAT(made.provenance,
              Contains(std::make_pair("gld:options",
                                      "{\"outputs\":[\"image\",\"depth\",\"points\",\"page\"],\"seed\":7}")));
  EXPECT_THAT(made.provenance, Contains(std::make_pair("gld:model", std::string(64, 'a'))));
}

TEST_F(SamplePage, TheSameRunGivesTheSameBytes) {
  write(small_run(40));
  const std::string html = page_html(page());
  EXPECT_EQ(page_html(page()), html);
  PageOptions fewer;
  fewer.page_points = 500;
  const Page thinned = page(fewer);
  EXPECT_LE(thinned.data.at("cloud").at("count").get<int>(), 500);
  EXPECT_NE(page_html(thinned), html);
}

// Returns Gaussians of which only the means matter.
GaussianSet gaussians_at(const std::vector<Eigen::Vector3f>& means) {
  GaussianSet set = zero_gaussians(static_cast<int64_t>(means.size()), 0);
  for (size_t i = 0; i < means.size(); ++i) {
    for (size_t axis = 0; axis < 3; ++axis) set.means[3 * i + axis] = means[i][static_cast<int>(axis)];
    set.rotations[4 * i] = 1;
  }
  return set;
}

TEST_F(SamplePage, GaussiansCountForTheMiddle) {
  auto without_points = small_run(40);
  without_points.points = false;
  write(without_points);
  // A box around all cameras of the drawn room, which is some units long.
  write_splat_ply(run() / kSplatFile, gaussians_at({{-100, -200, -300}, {300, 200, 100}}), {});
  const Page made = page();
  EXPECT_EQ(made.data.at("splats").at("count"), 2);
  // The means are floats, which hold these numbers exactly.
  EXPECT_EQ(made.data.at("origin"), nlohmann::ordered_json({100.0, 0.0, -100.0}));
  EXPECT_EQ(made.data.at("splats").at("low"), nlohmann::ordered_json({-200.0, -200.0, -200.0}));
}

TEST_F(SamplePage, SaysWhatIsMissingAndShowsTheRest) {
  write(small_run(40));
  std::filesystem::remove(run() / "images/view_04.png");
  write_file_atomically(run() / "sources/view_01.png", "no picture");
  std::filesystem::remove(run() / "points.ply");
  const Page made = page();
  EXPECT_THAT(made.doubts, Contains("images/view_04.png is left out of this page: the file is missing."));
  EXPECT_THAT(made.doubts, Contains(HasSubstr("sources/view_01.png is left out of this page: expected ")));
  EXPECT_EQ(made.data.at("cloud_note"),
            "This run has no point cloud: it was not asked for (--outputs points).");
  EXPECT_EQ(made.data.at("cloud").at("count"), 0);
  EXPECT_FALSE(made.data.at("views")[4].contains("picture"));
  EXPECT_TRUE(made.data.at("views")[4].contains("truth"));
  EXPECT_EQ(made.data.at("pictures").size(), 13u);
}

TEST_F(SamplePage, ReadsNothingOutsideOfTheFolder) {
  write(small_run(40));
  change_json("cameras.json", [](auto& json) {
    json["frames"][0]["image"] = "../elsewhere.png";
    json["frames"][1]["image"] = "/etc/passwd";
  });
  EXPECT_THAT(page().doubts,
              AllOf(Contains("../elsewhere.png is left out of this page: it lies outside of the run folder."),
                    Contains("/etc/passwd is left out of this page: it lies outside of the run folder.")));
}

TEST_F(SamplePage, AReportOfAnotherVersionIsShownAsFarAsItGoes) {
  auto without_depth = small_run(40);
  without_depth.depth = false;
  write(without_depth);
  write_file_atomically(run() / "report.json",
                        "{\"scene\": {\"views\": 3}, \"stages\": {}, \"warnings\": \"x\", \"options\": []}");
  const Page made = page();
  EXPECT_EQ(made.asked, "");
  EXPECT_THAT(made.doubts, testing::IsEmpty());
  EXPECT_EQ(made.data.at("views")[0].at("name"), "view_00");
  EXPECT_FALSE(made.data.contains("depth"));
  std::filesystem::remove(run() / "cameras.json");
  EXPECT_THAT(page().doubts, ElementsAre("cameras.json is left out of this page: the file is missing."));
}

TEST_F(SamplePage, HostileNamesAreText) {
  const std::string hostile = "</script><img src=x onerror=alert(1)>";
  auto named = small_run(40);
  named.scene_name = named.first_name = hostile;
  write(named);
  const Page made = page();
  EXPECT_EQ(made.data.at("views")[0].at("name"), hostile);
  EXPECT_THAT(page_html(made), Not(HasSubstr("<img src=x")));
}

// The page has 300,000 points of 1.1 million.
TEST_F(SamplePage, EightViewsStayBelowEightMegabytes) {
  test::DrawnRun large;
  large.width = 504;
  large.height = 280;
  large.sources = large.targets = 4;
  write(large);
  const std::string html = page_html(page());
  EXPECT_LT(html.size(), 8'000'000u);
  EXPECT_THAT(html, HasSubstr("data:image/"));
}

}  // namespace
}  // namespace gld
