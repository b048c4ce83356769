#include "gld/report/progress.h"

#include "gld/base/atomic_file.h"
#include "gld/base/run_journal.h"
#include "tests/support/temporary_folder.h"

#include <chrono>
#include <filesystem>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(Progress, SaysToOtherProgramsHowFarARunIs) {
  test::TemporaryFolder run;
  EXPECT_TRUE(read_run_progress(run.path()).is_null());
  note_stage(run.path(), "encoding");
  EXPECT_EQ(read_run_progress(run.path()).dump(),
            R"({"stage":"encoding","done":0,"total":null,"seconds_left":null,"note":""})");
  Progress progress({"level 1", 40, 10, run.path()});
  auto said = read_run_progress(run.path());
  EXPECT_EQ(said.at("done"), 10) << "of the run that this one goes on with";
  EXPECT_EQ(said.at("total"), 40);
  EXPECT_TRUE(said.at("seconds_left").is_null());
  progress.update(20, "soon");
  EXPECT_EQ(read_run_progress(run.path()).at("done"), 10) << "written twice within a second";
  std::this_thread::sleep_for(std::chrono::milliseconds(1100));
  progress.update(30, "t 0.5");
  said = read_run_progress(run.path());
  EXPECT_EQ(said.at("done"), 30);
  EXPECT_EQ(said.at("note"), "t 0.5");
  // 20 of its own steps took somewhat over a second: 10 are left. Those of before took no time of this run.
  EXPECT_GE(said.at("seconds_left"), 1);
  EXPECT_LE(said.at("seconds_left"), 60);
  progress.update(40);
  progress.finish();
  EXPECT_EQ(read_run_progress(run.path()).dump(),
            R"({"stage":"level 1","done":40,"total":40,"seconds_left":0,"note":""})");
}

TEST(Progress, GoesOnWhereItsFileCannotBeWritten) {
  test::TemporaryFolder run;
  const auto missing = run.path() / "missing";
  Progress progress({"scenes", 2, 0, missing});
  progress.update(1);
  progress.finish();
  EXPECT_FALSE(std::filesystem::exists(missing));
  write_file_atomically(run.path() / kRunProgress, "{");
  EXPECT_TRUE(read_run_progress(run.path()).is_null());
}

}  // namespace
}  // namespace gld
