#include "infer/run_export/run_export.h"

#include "datasets/formats/scene_reader.h"
#include "gld/base/configuration.h"
#include "gld/base/json_text.h"
#include "tests/infer/run_export/drawn_run.h"
#include "tests/infer/run_export/gltf_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/webp_frames.h"

#include <map>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::DrawnRun;
using test::error_of;
using test::TemporaryFolder;
using ::testing::HasSubstr;

class RunExport : public ::testing::Test {
 protected:
  RunExport() { test::write_drawn_run(folder_.path() / "run", {}); }

  ExportOptions options(const std::vector<std::string>& as, const std::string& out) const {
    ExportOptions options;
    options.run = (folder_.path() / "run").string();
    options.as = as;
    options.out = (folder_.path() / out).string();
    return options;
  }
  nlohmann::json exported(const ExportOptions& options) {
    ::testing::internal::CaptureStdout();
    ::testing::internal::CaptureStderr();
    run_export(options);
    printed_ = ::testing::internal::GetCapturedStdout();
    warned_ = ::testing::internal::GetCapturedStderr();
    return parse_json(read_file(std::filesystem::path(options.out) / "report.json"), "report");
  }
  // Returns all files of an export beside what says how it was made.
  std::map<std::string, std::string> files(const std::string& out) const {
    std::map<std::string, std::string> found;
    const auto place = folder_.path() / out;
    for (const auto& item : std::filesystem::recursive_directory_iterator(place)) {
      const std::string name = item.path().lexically_relative(place).string();
      if (item.is_directory() || name == "report.json" || name == "config.yaml" || name == ".gld-run")
        continue;
      found[name] = read_file(item.path());
    }
    return found;
  }

  const TemporaryFolder folder_;
  std::string printed_;
  std::string warned_;
};

TEST_F(RunExport, WritesTheSameBytesTogetherAndApart) {
  ExportOptions together = options({"mp4", "glb", "webp", "colmap", "nerfstudio"}, "together");
  together.between = 1;
  exported(together);
  std::map<std::string, std::string> apart;
  for (const std::string& format : export_format_names()) {
    ExportOptions one = options({format}, "only_" + format);
    one.between = 1;
    exported(one);
    apart.merge(files("only_" + format));
  }
  const auto all = files("together");
  EXPECT_EQ(all.size(), apart.size());
  for (const auto& [name, bytes] : all) EXPECT_EQ(bytes == apart[name], true) << name;
  for (const char* name : {"scene.glb", "colmap/sparse/0/points3D.bin", "colmap/sparse_txt/images.txt",
                           "colmap/images/view_03.png", "nerfstudio/transforms.json", "nerfstudio/points.ply",
                           "nerfstudio/depth/view_00.png", "path.webp", "path.mp4"}) {
    EXPECT_EQ(all.count(name), 1U) << name;
  }
  // What is there opens.
  test::expect_valid_gltf(test::read_gltf(folder_.path() / "together" / "scene.glb"));
  EXPECT_EQ(open_scene(folder_.path() / "together" / "colmap").frames.size(), 4U);
  EXPECT_EQ(open_scene(folder_.path() / "together" / "nerfstudio").frames.size(), 4U);
  // Pictures between views are not passed off as generated ones.
  EXPECT_THAT(printed_, HasSubstr("path.mp4"));
  EXPECT_THAT(all.at("path.webp"), HasSubstr("<gld:carried_frames>1, 3, 5, 7</gld:carried_frames>"));
  EXPECT_THAT(all.at("path.mp4"), HasSubstr("gld:carried_frames"));
}

// A run folder that was moved, and that nobody may write into.
TEST_F(RunExport, ReadsTheRunAlone) {
  exported(options({"glb", "colmap", "nerfstudio", "webp"}, "first"));
  const auto before = files("first");
  std::filesystem::rename(folder_.path() / "run", folder_.path() / "moved");
  ExportOptions moved = options({"glb", "colmap", "nerfstudio", "webp"}, "second");
  moved.run = (folder_.path() / "moved").string();
  const auto kept = files("moved");
  exported(moved);
  EXPECT_EQ(files("moved") == kept, true);
  EXPECT_EQ(files("second") == before, true);
}

TEST_F(RunExport, ReportsWhatItWrote) {
  ExportOptions few = options({"glb", "colmap", "webp"}, "out");
  few.max_points = 200;
  few.surface_vertices = 500;
  few.between = 2;
  const auto report = exported(few);
  EXPECT_LE(report.at("glb").at("points"), 200);
  EXPECT_GT(report.at("glb").at("points"), 50);
  EXPECT_EQ(report.at("colmap").at("points"), report.at("glb").at("points"));
  EXPECT_LE(report.at("glb").at("vertices"), 500);
  // 4 views of 48x36 have 6912 pixels.
  EXPECT_EQ(report.at("glb").at("surface_step"), 4);
  EXPECT_EQ(report.at("model").at("hash"), "0123456789abcdef");
  EXPECT_EQ(report.at("film").at("pictures"), 12);
  EXPECT_TRUE(report.at("warnings").empty());
  EXPECT_THAT(
      printed_,
      HasSubstr("12 pictures at 12 a second, there and back, because the path does not close; carried "
                "by depth between generated views, and not generated: 1-2, 4-5, 7-8, 10-11"));
}

TEST_F(RunExport, WarnsOfWhatIsNotThere) {
  std::filesystem::remove(folder_.path() / "run" / "points.ply");
  const auto report = exported(options({"glb", "colmap", "nerfstudio"}, "out"));
  EXPECT_EQ(report.at("warnings").size(), 1U);
  EXPECT_THAT(warned_, HasSubstr("There are no points, because the run has no points.ply"));
  EXPECT_EQ(report.at("colmap").at("points"), 0);
  DrawnRun drawn;
  drawn.depth = false;
  std::filesystem::remove_all(folder_.path() / "run");
  test::write_drawn_run(folder_.path() / "run", drawn);
  exported(options({"glb"}, "without_depth"));
  EXPECT_THAT(warned_, HasSubstr("There are no surfaces, because the run has no depth"));
}

TEST_F(RunExport, RefusesBeforeItWrites) {
  const auto refusal = [&](const ExportOptions& asked) {
    std::string said = error_of([&] { run_export(asked); });
    EXPECT_FALSE(std::filesystem::exists(asked.out)) << said;
    return said;
  };
  EXPECT_EQ(
      refusal(options({}, "out")),
      "--as: expected some of glb, colmap, nerfstudio, webp or mp4, found nothing; add for example --as glb.");
  EXPECT_EQ(
      refusal(options({"glb", "colmpa"}, "out")),
      "--as: expected glb, colmap, nerfstudio, webp or mp4, found \"colmpa\"; did you mean \"colmap\"?");
  EXPECT_EQ(refusal(options({"glb", "glb"}, "out")),
            "--as: expected each format once, found glb twice; leave one out.");
  ExportOptions unused = options({"glb", "colmap"}, "out");
  unused.named = {"out", "max_points", "between"};
  EXPECT_EQ(
      refusal(unused),
      "--between: expected webp or mp4 in --as, without which nothing looks at it, found none; change that, or "
      "leave --between out.");
  unused.as.emplace_back("webp");
  EXPECT_NO_THROW(unused.check());
  ExportOptions nameless = options({"glb"}, "out");
  nameless.run.clear();
  EXPECT_THAT(refusal(nameless), HasSubstr("expected the run folder of a gld sample, found nothing"));
  nameless.run = (folder_.path() / "nowhere").string();
  EXPECT_THAT(refusal(nameless), HasSubstr("expected a run folder of gld sample, found nothing"));
  const std::string place = (folder_.path() / "run").string();
  DrawnRun drawn;
  drawn.target_images = false;
  std::filesystem::remove_all(place);
  test::write_drawn_run(place, drawn);
  EXPECT_EQ(refusal(options({"colmap"}, "out")),
            place +
                ": expected pictures of all views, found none of view_01; sample again with --outputs "
                "image,depth,points.");
  drawn.target_images = true;
  drawn.depth = drawn.points = false;
  std::filesystem::remove_all(place);
  test::write_drawn_run(place, drawn);
  EXPECT_EQ(refusal(options({"glb"}, "out")),
            place +
                ": expected depth or points for --as glb, found neither; sample again with --outputs "
                "image,depth,points, or leave glb out.");
  ExportOptions between = options({"webp"}, "out");
  between.between = 1;
  EXPECT_THAT(refusal(between), HasSubstr("--between: expected depth of the target views"));
  // The run's own folder is no place to write into.
  ExportOptions inside = options({"webp"}, "run");
  EXPECT_THAT(error_of([&] { run_export(inside); }),
              HasSubstr("expected a new or empty folder, found a run of gld sample"));
}

// What an earlier export wrote goes with the first result of the new one.
TEST_F(RunExport, OverwritesAnEarlierExport) {
  exported(options({"colmap", "nerfstudio"}, "out"));
  EXPECT_THAT(error_of([&] { run_export(options({"glb"}, "out")); }),
              HasSubstr("an earlier run of gld export"));
  ExportOptions again = options({"glb"}, "out");
  again.overwrite = true;
  exported(again);
  const auto found = files("out");
  ASSERT_EQ(found.size(), 1U);
  EXPECT_EQ(found.begin()->first, "scene.glb");
  // Half of a run's files is no run.
  std::filesystem::remove(folder_.path() / "run" / "images" / "view_02.png");
  EXPECT_THAT(error_of([&] { run_export(again); }), HasSubstr("view_02.png"));
  EXPECT_EQ(files("out") == found, true);
}

}  // namespace
}  // namespace gld
