#include "infer/page/report_command.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/json_text.h"
#include "gld/base/run_journal.h"
#include "infer/page/sample_page.h"
#include "tests/support/drawn_run.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::Contains;
using testing::HasSubstr;

std::string written(const std::filesystem::path& run, const ReportOptions& options) {
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  report_run(run, {sample_page_maker(options)});
  const std::string text = testing::internal::GetCapturedStdout();
  EXPECT_THAT(text, HasSubstr((run / kPageFile).string()));
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              HasSubstr("warning: The cameras of the photographs are not sure"));
  return read_file(run / kPageFile);
}

TEST(ReportCommand, MakesThePageThatTheRunMade) {
  test::TemporaryFolder temporary;
  const auto run = temporary.path() / "run";
  std::filesystem::create_directories(run);
  test::DrawnRun drawn;
  drawn.width = drawn.height = 40;
  test::write_drawn_run(run, drawn);
  PageOptions of_run;
  of_run.page_points = 700;
  auto report = parse_ordered_json(read_file(run / "report.json"), "report");
  report["options"]["page"] = to_json(of_run);
  write_file_atomically(run / "report.json", json_text(report));
  write_run_page(run, of_run);
  const std::string made = read_file(run / kPageFile);
  std::filesystem::remove(run / kPageFile);
  ReportOptions options;
  EXPECT_EQ(written(run, options), made);
  // A copy of the folder elsewhere says the same.
  std::filesystem::copy(run, temporary.path() / "copy", std::filesystem::copy_options::recursive);
  EXPECT_EQ(written(temporary.path() / "copy", options), made);
  options.page.page_points = 400;
  EXPECT_EQ(written(run, options), made);
  options.named = {"page.page_points"};
  EXPECT_NE(written(run, options), made);
  // The run's journal knows the page.
  EXPECT_THAT(RunJournal::find(run)->written, Contains(kPageFile));
}

TEST(ReportCommand, RefusesWhatIsNoFinishedRunOfSample) {
  test::TemporaryFolder temporary;
  const auto run = temporary.path() / "run";
  const ReportOptions options;
  const auto refusal = [&] { return test::error_of([&] { report_run(run, {sample_page_maker(options)}); }); };
  const std::string remedy = "; name the folder that the command wrote with --out.";
  EXPECT_EQ(refusal(), run.string() + ": expected the folder of a run, found nothing" + remedy);
  std::filesystem::create_directories(run);
  EXPECT_EQ(
      refusal(),
      run.string() + ": expected the folder of a run, with config.yaml, found a folder without it" + remedy);
  write_file_atomically(run / "config.yaml", "# gld synth: the options of this run, defaults included\n");
  EXPECT_EQ(
      refusal(),
      run.string() +
          ": expected a run of gld sample, found one of gld synth; look at report.json and the pictures beside it.");
  write_file_atomically(run / "config.yaml", "# gld sample: the options of this run, defaults included\n");
  EXPECT_EQ(
      refusal(),
      run.string() +
          ": expected a finished run, with report.json, found one that was stopped before; finish it with "
          "--resume, or run the command again.");
  write_file_atomically(run / "report.json", "{");
  EXPECT_THAT(refusal(), HasSubstr("report.json:1: expected JSON"));
  EXPECT_FALSE(std::filesystem::exists(run / kPageFile));
  {
    const RunJournal journal(run);
    EXPECT_THAT(refusal(), HasSubstr("run"));
  }
}

}  // namespace
}  // namespace gld
