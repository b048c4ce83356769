#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "infer/evaluate/evaluation.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/forked_processes.h"
#include "tests/support/temporary_folder.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using testing::HasSubstr;

void write_model(const std::filesystem::path& folder) {
  test::in_processes(1, folder, [&](const ProcessesOptions&) {
    auto model = small_bundle_options();
    model.trained_sizes = {"56x56"};
    write_random_bundle(folder / "model", model, 7);
  });
}

EvaluationOptions three_rooms(const std::filesystem::path& folder, const std::string& run) {
  EvaluationOptions options;
  options.model = (folder / "model").string();
  options.synthetic = 3;
  options.generator.frames = 6;
  options.generator.width = options.generator.height = 56;
  options.views.views = 3;
  options.views.shortest_interval = options.views.longest_interval = 1;
  options.solver.evaluations = 2;
  options.source_counts = {1, 2};
  options.pictures = 2;
  options.threads = 1;
  options.out = (folder / run).string();
  return options;
}

void evaluate_in(int64_t count, const std::filesystem::path& folder, EvaluationOptions options) {
  test::in_processes(count, folder, [&](const ProcessesOptions& processes) {
    options.processes = processes;
    const std::string said = evaluate(options);
    // Rank 0 alone has something to say.
    if (said.empty() != (processes.rank > 0)) throw std::runtime_error("said: " + said);
  });
}

void expect_same_files(const std::filesystem::path& a, const std::filesystem::path& b) {
  int64_t files = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(a)) {
    const auto name = std::filesystem::relative(entry.path(), a);
    if (!entry.is_regular_file() || name == "config.yaml") continue;  // which says where it writes
    EXPECT_EQ(read_file(entry.path()), read_file(b / name)) << name;
    ++files;
  }
  EXPECT_GT(files, 8);  // 3 scenes, 2 sheets, 2 tables, the report, plots
}

TEST(DistributedEvaluation, TwoAndThreeProcessesWriteTheSameFilesAsOne) {
  const test::TemporaryFolder folder;
  write_model(folder.path());
  evaluate_in(1, folder.path(), three_rooms(folder.path(), "one"));
  for (const int64_t count : {2, 3}) {
    const std::string run = "of_" + std::to_string(count);
    evaluate_in(count, folder.path(), three_rooms(folder.path(), run));
    expect_same_files(folder.path() / "one", folder.path() / run);
    EXPECT_TRUE(std::filesystem::exists(folder.path() / run / "sheets"));
  }
}

TEST(DistributedEvaluation, ResumesInAnotherNumberOfProcesses) {
  const test::TemporaryFolder folder;
  write_model(folder.path());
  auto options = three_rooms(folder.path(), "run");
  options.pictures = 0;
  evaluate_in(2, folder.path(), options);
  const auto table = read_file(folder.path() / "run" / "eval.csv");
  const auto first = folder.path() / "run" / "scenes" / "000000.json";
  const auto kept = std::filesystem::last_write_time(first);
  for (const char* file : {"eval.csv", "scenes/000001.json", "scenes/000002.json"}) {
    ASSERT_TRUE(std::filesystem::remove(folder.path() / "run" / file));
  }
  options.resume = true;
  evaluate_in(3, folder.path(), options);
  EXPECT_EQ(read_file(folder.path() / "run" / "eval.csv"), table);
  EXPECT_EQ(std::filesystem::last_write_time(first), kept);
}

TEST(DistributedEvaluation, ProcessesOfOtherOptionsAreNamed) {
  const test::TemporaryFolder folder;
  write_model(folder.path());
  const int64_t port = test::free_port();
  std::vector<test::Child> children;
  for (int64_t rank = 0; rank < 2; ++rank) {
    children.push_back(test::start(folder.path(), "rank" + std::to_string(rank), [&] {
      auto options = three_rooms(folder.path(), "run");
      options.seed = rank;
      options.processes = test::processes(rank, 2, port);
      evaluate(options);
    }));
  }
  for (const auto& child : children) {
    EXPECT_EQ(test::status_of(child), 1);
    EXPECT_THAT(read_file(child.said), HasSubstr("rank 1: expected the options of rank 0 (seed 0), found 1; "
                                                 "start every process with the same options."));
  }
}

}  // namespace
}  // namespace gld
