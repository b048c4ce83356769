#include "gld/report/run_folder.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/machine/stage_record.h"
#include "gld/report/progress.h"
#include "tests/support/error_of.h"
#include "tests/support/resident_memory.h"
#include "tests/support/temporary_folder.h"

#include <chrono>
#include <fstream>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
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
  RunFolder run(path, "count", CountOptions(), EarlierRun::kRefuse);
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
  EXPECT_NO_THROW(RunFolder(path, "count", CountOptions(), EarlierRun::kRefuse));
  EXPECT_FALSE(std::filesystem::exists(path / half));
  EXPECT_TRUE(std::filesystem::exists(path / "config.yaml"));
}

TEST(RunFolder, AReportWithBytesThatAreNoUtf8IsWritten) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "run\xFF\x1b[2J";
  RunFolder run(path, "count", CountOptions(), EarlierRun::kRefuse);
  run.write_report({{"scene", "\xFF"}});
  run.note("report", "report.json");
  EXPECT_EQ(nlohmann::json::parse(read_file(path / "report.json")).at("scene"), "\xEF\xBF\xBD");
  EXPECT_THAT(run.closing_box(), testing::HasSubstr("run\\xff\\x1b[2J"));
}

struct CountAgainOptions : CountOptions {
  bool overwrite = true, resume = true;
  void visit(FieldVisitor& visitor) override {
    CountOptions::visit(visitor);
    visitor.boolean({"overwrite", "remove"}, overwrite);
    visitor.boolean({"resume", "continue"}, resume);
  }
};

// Otherwise gld COMMAND --config config.yaml would remove the run that it repeats.
TEST(RunFolder, TheConfigurationDoesNotSayWhatBecameOfAnEarlierRun) {
  test::TemporaryFolder temporary;
  const RunFolder run(temporary.path() / "run", "count", CountAgainOptions(), EarlierRun::kRefuse);
  EXPECT_EQ(read_file(temporary.path() / "run" / "config.yaml"),
            "# gld count: the options of this run, defaults included\ncount: 3\n");
}

std::string refusal(const std::filesystem::path& path, const std::string& command, EarlierRun earlier) {
  auto checked = test::error_of([&] { check_run_folder(path, command, earlier); });
  EXPECT_EQ(test::error_of([&] { RunFolder(path, command, CountOptions(), earlier); }), checked);
  return checked;
}

// Takes the rights of the superuser from this process while it lives, who may write anywhere.
class OrdinaryUser {
 public:
  OrdinaryUser() {
    if (is_superuser_) {
      EXPECT_EQ(seteuid(65534), 0);
    }
  }
  ~OrdinaryUser() {
    if (is_superuser_) {
      EXPECT_EQ(seteuid(0), 0);
    }
  }
  OrdinaryUser(const OrdinaryUser&) = delete;
  OrdinaryUser& operator=(const OrdinaryUser&) = delete;

 private:
  bool is_superuser_ = geteuid() == 0;
};

TEST(RunFolder, WhatCannotBeCreatedIsRefusedBeforehand) {
  test::TemporaryFolder temporary;
  const auto file = temporary.path() / "file";
  write_file_atomically(file, "text");
  for (const char* below : {"run", "runs/one", "runs/one/"}) {
    EXPECT_EQ(refusal(file / below, "count", EarlierRun::kRefuse),
              (file / below).string() + ": expected a folder to write into, found the file " + file.string() +
                  " on the way to it; choose another --out.");
  }
  const auto read_only = temporary.path() / "read_only", inside = read_only / "inside";
  std::filesystem::create_directories(inside);
  using std::filesystem::perms;
  constexpr perms kNoWriting = perms::owner_read | perms::owner_exec | perms::group_read | perms::group_exec |
                               perms::others_read | perms::others_exec;
  std::filesystem::permissions(temporary.path(), kNoWriting | perms::owner_write);
  for (const auto& folder : {inside, read_only}) std::filesystem::permissions(folder, kNoWriting);
  {
    const OrdinaryUser user;
    for (const auto& [folder, there] : {std::pair{read_only / "run", read_only}, {inside, inside}}) {
      EXPECT_EQ(refusal(folder, "count", EarlierRun::kRefuse),
                folder.string() + ": expected a folder that can be written into, found " + there.string() +
                    " (Permission denied); choose another --out, or change its permissions.");
    }
    EXPECT_THAT(refusal(inside / "x" / "y", "count", EarlierRun::kOverwrite),
                testing::HasSubstr(inside.string()));
  }
  for (const auto& folder : {read_only, inside}) std::filesystem::permissions(folder, perms::owner_all);
}

TEST(RunFolder, NeverWritesOverSomethingElse) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "holiday";
  std::filesystem::create_directory(path);
  write_file_atomically(path / "photo.jpg", "x");
  for (const auto earlier : {EarlierRun::kRefuse, EarlierRun::kOverwrite, EarlierRun::kContinue}) {
    EXPECT_EQ(refusal(path, "count", earlier),
              path.string() +
                  ": expected a new or empty folder, found a folder with other files; choose another --out.");
  }
  EXPECT_EQ(refusal(path / "photo.jpg", "count", EarlierRun::kRefuse),
            (path / "photo.jpg").string() +
                ": expected a folder to write into, found a file; choose another --out.");
  EXPECT_EQ(refusal("", "count", EarlierRun::kRefuse),
            "--out: expected a folder to write into, found nothing; add for example --out runs/count.");
  const auto run = temporary.path() / "run";
  { const RunFolder first(run, "count", CountOptions(), EarlierRun::kRefuse); }
  EXPECT_EQ(
      refusal(run, "sample", EarlierRun::kOverwrite),
      run.string() + ": expected a new or empty folder, found a run of gld count; choose another --out.");
}

TEST(RunFolder, AnEarlierRunIsRefusedOrItsFilesAndNoOthersGo) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "run";
  {
    const RunFolder first(path, "count", CountOptions(), EarlierRun::kRefuse);
    write_file_atomically(first.subfolder("images") / "old.png", "x");
    write_file_atomically(first.subfolder("depth") / "old.pfm", "x");
    first.write_report({{"answer", 41}});
  }
  write_file_atomically(path / "notes.txt", "mine");
  write_file_atomically(path / "images" / "mine.png", "mine");
  EXPECT_EQ(refusal(path, "count", EarlierRun::kRefuse),
            path.string() +
                ": expected a new or empty folder, found an earlier run of gld count; choose another "
                "--out, or add --overwrite to remove what that run wrote.");
  EXPECT_TRUE(std::filesystem::exists(path / "images" / "old.png"));
  {
    const RunFolder second(path, "count", CountOptions(), EarlierRun::kOverwrite);
    EXPECT_FALSE(std::filesystem::exists(path / "images" / "old.png"));
    EXPECT_FALSE(std::filesystem::exists(path / "depth"));
    EXPECT_FALSE(std::filesystem::exists(path / "report.json"));
    EXPECT_EQ(read_file(path / "notes.txt"), "mine");
    EXPECT_EQ(read_file(path / "images" / "mine.png"), "mine");
    second.write_report({{"answer", 42}});
  }
  // Continued, nothing goes.
  const RunFolder third(path, "count", CountOptions(), EarlierRun::kContinue);
  EXPECT_TRUE(std::filesystem::exists(path / "report.json"));
}

TEST(RunFolder, ARefusalAfterTheFolderIsOpenLeavesTheEarlierRun) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "run";
  {
    const RunFolder first(path, "count", CountOptions(), EarlierRun::kRefuse);
    write_file_atomically(first.subfolder("images") / "old.png", "x");
    first.write_report({{"answer", 41}});
  }
  CountOptions other;
  other.count = 4;
  try {
    const RunFolder second(path, "count", other, EarlierRun::kOverwrite);
    EXPECT_FALSE(std::filesystem::exists(path / "report.json"));
    throw std::runtime_error("a schedule file that does not exist");
  } catch (const std::runtime_error&) {
    EXPECT_TRUE(std::filesystem::exists(path / "images" / "old.png"));
  }
  EXPECT_EQ(nlohmann::json::parse(read_file(path / "report.json")).at("answer"), 41);
  EXPECT_THAT(read_file(path / "config.yaml"), testing::HasSubstr("count: 3"));
}

// It has nothing that could be lost, and --resume says to begin again.
TEST(RunFolder, ARunWithoutAResultMayBeginAgain) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "run";
  { const RunFolder killed(path, "count", CountOptions(), EarlierRun::kRefuse); }
  EXPECT_NO_THROW(RunFolder(path, "count", CountOptions(), EarlierRun::kRefuse));
}

TEST(RunFolder, ARunOfAProgramWithoutJournalIsContinuedButNotRemoved) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "run";
  std::filesystem::create_directory(path);
  write_file_atomically(path / "config.yaml", "# gld count: the options of this run, defaults included\n");
  write_file_atomically(path / "step_1.safetensors", "x");
  { const RunFolder continued(path, "count", CountOptions(), EarlierRun::kContinue); }
  EXPECT_EQ(
      refusal(path, "count", EarlierRun::kOverwrite),
      path.string() +
          ": expected a run folder that says what the run wrote (.gld-run), found one that a program of "
          "before did not note everything in; remove the folder yourself or choose another --out.");
}

TEST(RunFolder, KilledBeforeItsConfigurationItMayBeginAgain) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "run";
  std::filesystem::create_directory(path);
  { const RunJournal begun(path); }
  const RunFolder run(path, "count", CountOptions(), EarlierRun::kRefuse);
  EXPECT_TRUE(std::filesystem::exists(path / "config.yaml"));
}

TEST(RunFolder, ASecondRunAtTheSameTimeIsRefused) {
  test::TemporaryFolder temporary;
  const auto path = temporary.path() / "run";
  {
    const RunFolder first(path, "count", CountOptions(), EarlierRun::kRefuse);
    for (const auto earlier : {EarlierRun::kRefuse, EarlierRun::kOverwrite, EarlierRun::kContinue}) {
      EXPECT_THAT(
          refusal(path, "count", earlier),
          testing::MatchesRegex(".*: expected a run folder that no other process writes, found one that "
                                "another process is writing \\(process [0-9]+ on .*\\); wait for it or "
                                "choose another --out\\."));
    }
  }
  const RunFolder second(path, "count", CountOptions(), EarlierRun::kOverwrite);
}

TEST(StageRecords, KeepTimeAndMemoryAlsoOfAFailedStage) {
  StageRecords stages;
  constexpr auto kSlept = std::chrono::milliseconds(20);
  stages.run("allocate", [&] {
    std::vector<char> block(64 << 20, 1);
    char* volatile read = block.data();  // or the compiler may leave the block out
    EXPECT_EQ(read[1 << 20], 1);
    EXPECT_GT(test::resident_bytes(), 64 << 20);
    std::this_thread::sleep_for(kSlept);
  });
  EXPECT_THROW(stages.run("fail", [] { throw std::runtime_error("no"); }), std::runtime_error);
  ASSERT_EQ(stages.records().size(), 2u);
  EXPECT_GT(stages.records()[0].peak_bytes, 64 << 20);
  EXPECT_GE(stages.records()[0].seconds, 0.02);
  EXPECT_LT(stages.records()[0].seconds, 60);  // seconds, and not parts of them
  EXPECT_EQ(stages.to_json()[1].at("stage"), "fail");
}

// ulimit -v: what the system has free is of no use beyond it.
TEST(StageRecords, AvailableMemoryIsThatOfTheAddressSpaceToo) {
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_AS, &before), 0);
  constexpr int64_t kGibibyte = int64_t{1} << 30;
  int64_t mapped = 0;
  std::ifstream pages("/proc/self/statm");
  pages >> mapped;
  mapped *= ::sysconf(_SC_PAGESIZE);
  rlimit limited = before;
  limited.rlim_cur = static_cast<rlim_t>(mapped + kGibibyte);
  ASSERT_EQ(::setrlimit(RLIMIT_AS, &limited), 0);
  const int64_t available = available_memory_bytes();
  ASSERT_EQ(::setrlimit(RLIMIT_AS, &before), 0);
  EXPECT_GT(available, 0);
  EXPECT_LE(available, kGibibyte + (1 << 20));  // but for what was unmapped in between
}

TEST(Text, DurationsAndSizes) {
  EXPECT_EQ(duration_text(4.25), "4.2 s");
  EXPECT_EQ(duration_text(59), "59 s");
  EXPECT_EQ(duration_text(200), "3 min 20 s");
  EXPECT_EQ(duration_text(3720), "1 h 02 min");
  EXPECT_EQ(bytes_text(1500), "1.5 kB");
  EXPECT_EQ(bytes_text(2'340'000'000), "2.34 GB");
}

}  // namespace
}  // namespace gld
