#include "infer/run_export/finished_run.h"

#include "gld/base/atomic_file.h"
#include "gld/base/json_text.h"
#include "tests/infer/run_export/drawn_run.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::DrawnRun;
using test::error_of;
using test::TemporaryFolder;
using ::testing::HasSubstr;

class FinishedRuns : public ::testing::Test {
 protected:
  std::filesystem::path run() const { return folder_.path() / "run"; }
  std::string error() const {
    return error_of([&] { open_finished_run(run()); });
  }
  void change_report(const std::function<void(nlohmann::json&)>& change) const {
    auto report = parse_json(read_file(run() / "report.json"), "report");
    change(report);
    write_file_atomically(run() / "report.json", report.dump());
  }
  const TemporaryFolder folder_;
};

TEST_F(FinishedRuns, HoldWhatTheFolderHas) {
  DrawnRun drawn;
  drawn.views = 3;
  const auto views = test::write_drawn_run(run(), drawn);
  const FinishedRun found = open_finished_run(run());
  ASSERT_EQ(found.views.size(), 3U);
  EXPECT_FALSE(found.views[0].target);
  EXPECT_TRUE(found.views[1].target);
  EXPECT_EQ(found.views[2].name, "view_02");
  EXPECT_EQ(found.model_hash, "0123456789abcdef");
  EXPECT_EQ(found.seed, 7);
  EXPECT_EQ(found.precision, "float32");
  // Where the run lies is nobody's business, and where its scene does.
  EXPECT_EQ(found.options, R"({"scene":"one","seed":7})");
  EXPECT_EQ(found.cloud, run() / "points.ply");
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(found.views[i].camera.intrinsics, views[i].camera.intrinsics);
    EXPECT_EQ(found.views[i].picture().rgb, views[i].image.rgb);
    const DepthMap depth = found.views[i].depth_map();
    for (size_t k = 0; k < depth.metres.size(); ++k)
      ASSERT_NEAR(depth.metres[k], views[i].depth.metres[k], 0.51 * found.views[i].depth_unit);
  }
}

// A pixel of the largest value only says "at least that far".
TEST_F(FinishedRuns, DoNotTakeTheLargestDepthForOne) {
  test::write_drawn_run(run(), {});
  FinishedRun found = open_finished_run(run());
  DepthMap map(48, 36);
  map.at(0, 0) = 65535;
  map.at(1, 0) = 65534;
  export_depth_png(run() / "depth" / "view_00.png", map, 1, {});
  found.views[0].depth_unit = 1;
  const DepthMap read = found.views[0].depth_map();
  EXPECT_EQ(read.at(0, 0), 0);
  EXPECT_EQ(read.at(1, 0), 65534);
  EXPECT_EQ(read.at(2, 0), 0);
}

// With --size photographs pictures are larger than depth, which has cameras of its own.
TEST_F(FinishedRuns, KnowTheCamerasOfDepth) {
  const auto views = test::write_drawn_run(run(), {});
  CameraList list = read_cameras_json(run() / "cameras.json");
  write_cameras_json(run() / "depth_cameras.json", list);
  for (CameraRecord& record : list.records) {
    record.camera.width *= 2;
    record.camera.height *= 2;
    record.camera.intrinsics.topRows<2>() *= 2;
    record.depth.clear();
    record.depth_unit = 0;
  }
  write_cameras_json(run() / "cameras.json", list);
  const FinishedRun found = open_finished_run(run());
  EXPECT_EQ(found.views[1].camera.width, 96);
  EXPECT_EQ(found.views[1].depth_camera.width, 48);
  EXPECT_EQ(found.views[1].depth_map().width, 48);
  EXPECT_THAT(error_of([&] { found.views[1].picture(); }),
              HasSubstr("expected the camera's size 96x72, found 48x36"));
}

TEST_F(FinishedRuns, LeaveOutACloudOfAnotherFrame) {
  test::write_drawn_run(run(), {});
  change_report([](nlohmann::json& report) { report.erase("depth_scale"); });
  const FinishedRun found = open_finished_run(run());
  EXPECT_TRUE(found.cloud.empty());
  EXPECT_EQ(found.cloud_missing,
            "points.ply is in the model's own frame, because neither the scale nor cameras were found");
  change_report([](nlohmann::json& report) { report["pose_alignment"] = {{"spread", 1}}; });
  EXPECT_FALSE(open_finished_run(run()).cloud.empty());
  std::filesystem::remove(run() / "points.ply");
  EXPECT_EQ(open_finished_run(run()).cloud_missing,
            "the run has no points.ply (--outputs image,depth,points makes one)");
}

TEST_F(FinishedRuns, SayInASentenceWhatIsWrong) {
  const std::string place = run().string();
  EXPECT_EQ(error(),
            place + ": expected a run folder of gld sample, found nothing; name the --out of a gld sample.");
  write_file_atomically(run(), "");
  EXPECT_EQ(error(),
            place + ": expected a run folder of gld sample, found a file; name the --out of a gld sample.");
  std::filesystem::remove(run());
  std::filesystem::create_directory(run());
  EXPECT_EQ(error(),
            place +
                ": expected a run folder of gld sample, found a folder without one; name the --out of a gld "
                "sample.");
  write_file_atomically(run() / "config.yaml", "# gld eval: the options of this run, defaults included\n");
  EXPECT_EQ(error(),
            place +
                ": expected a run folder of gld sample, found a run of gld eval; name the --out of a gld "
                "sample.");
  test::write_drawn_run(run(), {});
  for (const char* name : {"report.json", "cameras.json"}) {
    const std::string kept = read_file(run() / name);
    std::filesystem::remove(run() / name);
    EXPECT_EQ(error(),
              place + ": expected a finished run, which has " + name +
                  ", found one without it; let gld sample come to its end, with --resume where it was "
                  "stopped.");
    write_file_atomically(run() / name, "{");
    EXPECT_THAT(error(), HasSubstr(name));
    write_file_atomically(run() / name, "{}");
    EXPECT_THAT(error(), HasSubstr(name));
    write_file_atomically(run() / name, kept);
  }
  std::filesystem::remove(run() / "depth" / "view_01.png");
  EXPECT_EQ(error(), place + "/cameras.json view_01: expected the file " + place +
                         "/depth/view_01.png, found none; copy the run folder whole, or sample again.");
}

// A path in a file must not lead out of the folder.
TEST_F(FinishedRuns, StayInTheirFolder) {
  test::write_drawn_run(run(), {});
  CameraList list = read_cameras_json(run() / "cameras.json");
  list.records[0].image = "../secret.png";
  write_cameras_json(run() / "cameras.json", list);
  EXPECT_THAT(error(), HasSubstr("expected a path inside"));
}

}  // namespace
}  // namespace gld
