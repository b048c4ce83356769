#include "train/loop/metrics_log.h"

#include "gld/base/atomic_file.h"
#include "gld/base/run_journal.h"
#include "tests/support/temporary_folder.h"

#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

// --overwrite removes what is noted; a run that is refused before its first step leaves nothing.
TEST(MetricsLog, IsMadeWithItsFirstLineAndNotedAsWritten) {
  const test::TemporaryFolder run;
  const auto file = run.path() / "metrics.jsonl";
  {
    const RunJournal journal(run.path());
    MetricsLog log(file, 0);
    EXPECT_FALSE(std::filesystem::exists(file));
    log.append({{"step", 1}, {"loss", 0.5}});
    log.append({{"step", 2}, {"loss", 0.25}});
  }
  EXPECT_EQ(read_file(file), "{\"step\":1,\"loss\":0.5}\n{\"step\":2,\"loss\":0.25}\n");
  const auto found = RunJournal::find(run.path());
  ASSERT_TRUE(found.has_value());
  EXPECT_THAT(found->written, testing::ElementsAre("metrics.jsonl"));
}

TEST(MetricsLog, DamagedLinesAreLeftOut) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "metrics.jsonl";
  write_file_atomically(
      file,
      "{\"step\": 1, \"loss\": 2}\n"
      "{\"step\": \"2\", \"loss\": 3}\n"
      "{\"loss\": 3}\n[1]\n\xFF\n{\"step\": 3, \"loss\": 1e999}\n{\"step\": -4}\n{\"step\": 2.5}\n" +
          std::string(100'000, '[') + "\n{\"step\": 5, \"loss\": 4}\n{\"step\": 6, \"lo");
  const MetricsLog log(file, 5);
  const std::vector<std::pair<double, double>> expected = {{1, 2}, {5, 4}};
  EXPECT_EQ(log.series("loss"), expected);
  EXPECT_EQ(read_file(file), "{\"step\":1,\"loss\":2}\n{\"step\":5,\"loss\":4}\n");
}

}  // namespace
}  // namespace gld
