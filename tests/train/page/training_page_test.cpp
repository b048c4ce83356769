#include "train/page/training_page.h"

#include "gld/base/atomic_file.h"
#include "gld/base/run_journal.h"
#include "gld/page/run_page.h"
#include "gld/report/progress.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "train/page/live_training_page.h"

#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

// The last training of the small model's M1.
TEST(TrainingPage, ShowsHowARunWent) {
  const Page page = training_page(test::source_root() / "configs/tiny/training/level/part_4");
  EXPECT_EQ(page.title, "gld train level");
  EXPECT_EQ(page.verdict,
            "400 steps were done with 5451811 parameters, in 41.6 minutes; the loss ended at 0.241, from "
            "0.251; on held-out scenes flow loss went from 0.134 to 0.122.");
  EXPECT_THAT(page.doubts, testing::IsEmpty());
  const auto& parts = page.data.at("parts");
  ASSERT_EQ(parts.size(), 3u);
  const auto& charts = parts[0].at("charts");
  ASSERT_EQ(charts.size(), 5u);
  EXPECT_EQ(charts[0].at("series")[0].at("name"), "loss");
  EXPECT_EQ(charts[0].at("series")[0].at("points")[0].dump(), "[20.0,0.2507124558091164]");
  EXPECT_EQ(charts[2].at("series")[0].at("name"), "target psnr");
  EXPECT_EQ(parts[1].at("title"), "Held-out scenes");
  EXPECT_THAT(parts[1].at("rows").dump(), HasSubstr("[\"target psnr, dB\",\"21.7\","));
  EXPECT_EQ(parts[2].at("pictures").size(), 1u);
}

TEST(TrainingPage, ThinsLongCoursesAndSaysWhatWentWrong) {
  test::TemporaryFolder run;
  std::string lines;
  for (int step = 1; step <= 5000; ++step) {
    lines += "{\"step\":" + std::to_string(step) + ",\"loss\":" + std::to_string(step) + ",\"reward\":-1}\n";
  }
  lines +=
      "{\"step\":0,\"validation_error\":1}\n{\"step\":5000,\"validation_error\":2,\"validation_psnr\":null}\n\n";
  write_file_atomically(run.path() / "metrics.jsonl", lines);
  write_file_atomically(
      run.path() / "report.json",
      "{\"command\": \"train decoder\", \"steps\": 5000, \"skipped_steps\": 2, \"messages\": [\"a message\"]}");
  std::filesystem::create_directories(run.path() / "validation");
  for (const int step : {0, 200, 300, 400}) {
    write_file_atomically(
        run.path() / "validation" / ("step_000000" + std::to_string(step + 1000).substr(1) + ".png"),
        std::string("\x89PNG\r\n\x1a\n", 8));
  }
  const Page page = training_page(run.path());
  EXPECT_EQ(
      page.verdict,
      "5000 steps were done; the loss ended at 5e+03, from 1; on held-out scenes error went from 1 to 2: no "
      "better there than at first.");
  EXPECT_THAT(page.doubts,
              ElementsAre("2 steps were left out because their loss was not finite.", "a message"));
  const auto& chart = page.data.at("parts")[0].at("charts")[0];
  // A reward of -1 has no logarithm.
  EXPECT_EQ(chart.at("logarithmic"), false);
  const auto& points = chart.at("series")[0].at("points");
  EXPECT_EQ(points.size(), 600u);
  double sum = 0;
  for (const auto& point : points) sum += point[1].get<double>() / 600;
  EXPECT_NEAR(sum, 2500.5, 5);
  std::string names;
  for (const auto& picture : page.data.at("parts")[2].at("pictures"))
    names += picture.at("name").get<std::string>() + ", ";
  EXPECT_EQ(names, "before the first step, after step 300, after step 400, ");
}

TEST(TrainingPage, SharpnessIsBestWhereItIsTheTruths) {
  const test::TemporaryFolder run;
  write_file_atomically(
      run.path() / "metrics.jsonl",
      "{\"step\":1,\"loss\":3,\"communication_fraction\":0.1,\"validation_sharpness\":0.5}\n"
      "{\"step\":2,\"loss\":2,\"communication_fraction\":0.1,\"validation_sharpness\":0.9}\n"
      "{\"step\":3,\"loss\":1,\"communication_fraction\":0.1,\"validation_sharpness\":1.4}\n");
  write_file_atomically(run.path() / "report.json", "{\"command\": \"train decoder\", \"steps\": 3}");
  const Page page = training_page(run.path());
  const auto& parts = page.data.at("parts");
  EXPECT_THAT(parts[1].at("rows").dump(), HasSubstr("[\"sharpness\",\"0.5\",\"0.9\",\"1.4\",\"3\"]"));
  const auto& charts = parts[0].at("charts");
  ASSERT_EQ(charts.size(), 2u);
  EXPECT_EQ(charts[0].at("series").size(), 1u);
  EXPECT_EQ(charts[1].at("title"), "Held-out sharpness, of the truth's");
}

// The run is as the training loop leaves it in between.
void write_unfinished(const std::filesystem::path& run) {
  write_file_atomically(run / kRunConfiguration,
                        "# gld train level: the options of this run, defaults included\n");
  write_file_atomically(run / "metrics.jsonl", "{\"step\":20,\"loss\":0.5}\n{\"step\":40,\"loss\":0.4}\n");
  Progress({"training the level", 100, 0, run}).update(40, "loss 0.4");
  write_file_atomically(
      run / kRunProgress,
      R"({"stage": "a", "done": 40, "total": 100, "seconds_left": 130, "note": "loss 0.4"})");
}

TEST(TrainingPage, OfOneThatGoesOnSaysHowFarItIsAndLoadsItselfAgain) {
  test::TemporaryFolder run;
  write_unfinished(run.path());
  const Page page = unfinished_training_page(run.path(), UnfinishedTraining::kGoesOn);
  EXPECT_EQ(page.title, "gld train level");
  EXPECT_EQ(page.reload_seconds, kTrainingPageSeconds);
  EXPECT_EQ(
      page.verdict,
      "40 of 100 steps are done; 2 min 10 s are left. This page loads itself again every minute until the "
      "training ends.");
  EXPECT_EQ(page.data.at("parts")[0].at("charts")[0].at("series")[0].at("points").size(), 2u);
  EXPECT_THAT(page.data.at("facts").dump(), HasSubstr("loss 0.4"));
  std::filesystem::remove(run.path() / "metrics.jsonl");
  EXPECT_THAT(unfinished_training_page(run.path(), UnfinishedTraining::kGoesOn).doubts, testing::IsEmpty());
  EXPECT_THAT(unfinished_training_page(run.path(), UnfinishedTraining::kStopped).doubts, testing::SizeIs(1));
  std::filesystem::remove(run.path() / kRunProgress);
  EXPECT_THAT(unfinished_training_page(run.path(), UnfinishedTraining::kGoesOn).verdict,
              HasSubstr("The training has begun."));
}

// What a training that was killed left says that it goes on; gld report says what is true.
TEST(TrainingPage, OfOneThatWasKilledIsMadeByReport) {
  test::TemporaryFolder run;
  write_unfinished(run.path());
  const auto stopped = [](const std::filesystem::path& of) {
    return unfinished_training_page(of, UnfinishedTraining::kStopped);
  };
  testing::internal::CaptureStdout();
  report_run(run.path(), {{"train", training_page, stopped}});
  EXPECT_THAT(
      testing::internal::GetCapturedStdout(),
      HasSubstr("The training ended before its last step; what it said last was at 40 of 100 steps. The same "
                "command with --resume goes on from its last checkpoint."));
  EXPECT_THAT(read_file(run.path() / kPageFile), testing::Not(HasSubstr("http-equiv=\"refresh\"")));
}

TEST(LiveTrainingPage, IsOfARunThatGoesOnThenOfAStoppedOrFinishedOne) {
  test::TemporaryFolder run;
  const auto file = run.path() / kPageFile;
  write_unfinished(run.path());
  {
    LiveTrainingPage page(run.path());
    EXPECT_FALSE(std::filesystem::exists(file));
    page.follow();
    EXPECT_THAT(read_file(file), HasSubstr("http-equiv=\"refresh\""));
    std::filesystem::remove(file);
    page.follow();
    EXPECT_FALSE(std::filesystem::exists(file)) << "written again within the minute";
  }
  EXPECT_THAT(
      read_file(file),
      testing::AllOf(HasSubstr("The training ended before its last step; what it said last was at 40 of "
                               "100 steps. The same command with --resume goes on from its last checkpoint."),
                     testing::Not(HasSubstr("http-equiv=\"refresh\""))));
  {
    LiveTrainingPage page(run.path());
    page.follow();
    write_file_atomically(run.path() / "report.json", R"({"command": "train level", "steps": 100})");
    page.end();
  }
  EXPECT_THAT(read_file(file),
              testing::AllOf(HasSubstr("100 steps were done; the loss ended at 0.4, from 0.5."),
                             testing::Not(HasSubstr("http-equiv=\"refresh\""))));
}

TEST(TrainingPage, DoesWithoutMetricsAndRefusesBrokenOnes) {
  test::TemporaryFolder run;
  write_file_atomically(run.path() / "report.json", "{}");
  const Page page = training_page(run.path());
  EXPECT_EQ(page.title, "gld train");
  EXPECT_THAT(page.doubts, ElementsAre("metrics.jsonl is left out of this page: the file is missing."));
  write_file_atomically(run.path() / "metrics.jsonl", "{\"step\": 1}\n{\n");
  EXPECT_THAT(test::error_of([&] { training_page(run.path()); }), HasSubstr("metrics.jsonl, line 2"));
}

}  // namespace
}  // namespace gld
