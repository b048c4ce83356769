#include "gld/report/run_folder.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/machine/stage_record.h"
#include "gld/report/progress.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <csignal>
#include <stdexcept>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

namespace gld {
namespace {

struct CountOptions : OptionsGroup {
  int64_t count = 3;
  void visit(FieldVisitor& visitor) override { visitor.integer({"count", "how many"}, count, {1, 10}); }
};

TEST(RunFolder, WritesTheConfigurationFirstAndTheBoxLast) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "runs" / "one";
  RunFolder run(path, "count", CountOptions());
  CountOptions read;
  read.count = 1;
  load_yaml(read, path / "config.yaml");
  EXPECT_EQ(read.count, 3);
  run.write_report({{"answer", 42}});
  EXPECT_EQ(nlohmann::json::parse(read_file(path / "report.json")).at("answer"), 42);
  run.note("report", "report.json");
  run.note("all images", "images");
  EXPECT_THAT(run.closing_box(),
              testing::HasSubstr("| report      " + (path / "report.json").string() + " |"));
}

TEST(RunFolder, ARunThatWasKilledAtOnceLeavesAFolderThatCanBeUsed) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "run";
  std::filesystem::create_directories(path / "model");
  std::filesystem::remove_all(path / "model");
  // The name of this process, as after a restart in a container where numbers come again.
  const std::string half = ".config.partial-" + std::to_string(getpid()) + "-0.yaml";
  write_file_atomically(path / half, "# gld");
  EXPECT_NO_THROW(RunFolder(path, "count", CountOptions()));
  EXPECT_FALSE(std::filesystem::exists(path / half));
  EXPECT_TRUE(std::filesystem::exists(path / "config.yaml"));
}

TEST(RunFolder, AReportWithBytesThatAreNoUtf8IsWritten) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "run\xFF\x1b[2J";
  RunFolder run(path, "count", CountOptions());
  run.write_report({{"scene", "\xFF"}});
  run.note("report", "report.json");
  EXPECT_EQ(nlohmann::json::parse(read_file(path / "report.json")).at("scene"), "\xEF\xBF\xBD");
  EXPECT_THAT(run.closing_box(), testing::HasSubstr("run\\xff\\x1b[2J"));
}

TEST(RunFolder, NeverWritesOverSomethingElse) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "holiday";
  std::filesystem::create_directory(path);
  write_file_atomically(path / "photo.jpg", "x");
  EXPECT_EQ(test::error_of([&] { RunFolder(path, "count", CountOptions()); }),
            path.string() +
                ": expected an empty folder or an earlier run of gld count, found a folder with other files; "
                "choose another --out.");
  EXPECT_EQ(test::error_of([&] { RunFolder(path / "photo.jpg", "count", CountOptions()); }),
            (path / "photo.jpg").string() +
                ": expected a folder to write into, found a file; choose another --out.");
  EXPECT_EQ(test::error_of([&] { RunFolder("", "count", CountOptions()); }),
            "--out: expected a folder to write into, found nothing; add for example --out runs/count.");
  const RunFolder first(temporary.path() / "run", "count", CountOptions());
  EXPECT_NO_THROW(RunFolder(temporary.path() / "run", "count", CountOptions()));
  EXPECT_THAT(test::error_of([&] { RunFolder(temporary.path() / "run", "sample", CountOptions()); }),
              testing::HasSubstr("expected an empty folder or an earlier run of gld sample"));
}

TEST(StageRecords, KeepTimeAndMemoryAlsoOfAFailedStage) {
  StageRecords stages;
  stages.run("allocate", [] {
    std::vector<char> block(64 << 20, 1);
    EXPECT_GT(resident_bytes(), 64 << 20);
  });
  EXPECT_THROW(stages.run("fail", [] { throw std::runtime_error("no"); }), std::runtime_error);
  ASSERT_EQ(stages.records().size(), 2u);
  EXPECT_GT(stages.records()[0].peak_bytes, 64 << 20);
  EXPECT_GE(stages.records()[0].seconds, 0);
  EXPECT_EQ(stages.to_json()[1].at("stage"), "fail");
}

TEST(Text, DurationsAndSizes) {
  EXPECT_EQ(duration_text(4.25), "4.2 s");
  EXPECT_EQ(duration_text(59), "59 s");
  EXPECT_EQ(duration_text(200), "3 min 20 s");
  EXPECT_EQ(duration_text(3720), "1 h 02 min");
  EXPECT_EQ(bytes_text(1500), "1.5 kB");
  EXPECT_EQ(bytes_text(2'340'000'000), "2.34 GB");
}

TEST(Interrupt, StopsAtTheNextSafePoint) {
  install_interrupt_handler();
  EXPECT_NO_THROW(stop_if_interrupted("nothing"));
  std::raise(SIGINT);
  EXPECT_TRUE(interrupt_requested());
  try {
    stop_if_interrupted("2 of 3 views are finished");
    FAIL() << "it went on";
  } catch (const Interrupted& interrupted) {
    EXPECT_STREQ(interrupted.what(), "2 of 3 views are finished");
  }
}

}  // namespace
}  // namespace gld
