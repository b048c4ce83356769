#include "cli/convert_command.h"
#include "cli/inspect_command.h"
#include "gld/base/atomic_file.h"
#include "gld/base/run_journal.h"
#include "gld/tensors/weight_tensors.h"
#include "models/bundle/bundle.h"
#include "tests/support/data_folders.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <string>
#include <vector>

#include <torch/types.h>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

namespace gld {
namespace {

struct Outcome {
  int status = 0;
  std::string output;
  std::string errors;
};

Outcome run(const std::vector<std::string>& words) {
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  Outcome outcome;
  outcome.status = run_command_line({make_convert_command(), make_inspect_command()}, words);
  outcome.output = testing::internal::GetCapturedStdout();
  outcome.errors = testing::internal::GetCapturedStderr();
  return outcome;
}

TEST(WeightCommands, InspectPrintsLinesOrJson) {
  const test::TemporaryFolder folder;
  const std::string file = folder.path() / "w.safetensors";
  save_safetensors(file, {{"block.weight", torch::zeros({2, 3})}});
  const auto lines = run({"inspect", file});
  EXPECT_EQ(lines.status, 0);
  EXPECT_EQ(lines.output, file +
                              " (safetensors)\n"
                              "  block.weight  float32   (2, 3)\n"
                              "1 tensors, 6 elements, 24 B (6 float32)\n");
  const auto json = nlohmann::json::parse(run({"inspect", file, "--json"}).output);
  EXPECT_EQ(json["totals"]["bytes"], 24);
  EXPECT_EQ(json["tensors"][0]["dtype"], "float32");
}

TEST(WeightCommands, InspectSaysInOneSentenceWhatIsWrong) {
  const std::string text = (test::test_data() / "scenes/tartanair_hospital/pose_left.txt").string();
  const auto outcome = run({"inspect", text});
  EXPECT_EQ(outcome.status, 1);
  EXPECT_EQ(outcome.output, "");
  EXPECT_NE(outcome.errors.find(text +
                                ": expected a safetensors or PyTorch file, found neither by its first bytes"),
            std::string::npos)
      << outcome.errors;
}

TEST(WeightCommands, ConvertReports) {
  const test::TemporaryFolder folder;
  const std::string out = folder.path() / "bundle";
  const std::string level0 = test::test_data() / "stats/da3/normalization_stats_level0.pt";
  const auto outcome = run({"convert", "--statistics-level0", level0, "--out", out, "--store", "bfloat16"});
  EXPECT_EQ(outcome.status, 0) << outcome.errors;
  EXPECT_NE(
      outcome.output.find("statistics_level0  2 tensors, 3072 numbers in float32, from " + level0 + "\n"),
      std::string::npos)
      << outcome.output;
  EXPECT_NE(outcome.output.find("level1             missing; convert it into the same folder\n"),
            std::string::npos);
  EXPECT_EQ(ModelBundle::open(out).load_statistics(cascade(1, 0)).patches.channels(), 1536);
  EXPECT_NE(run({"convert", "--out", out}).status, 0);
}

// Neither a run's folder nor one with anything else becomes a bundle; what a killed conversion left goes.
TEST(WeightCommands, ConvertWritesIntoBundlesAlone) {
  const test::TemporaryFolder folder;
  const std::string level0 = test::test_data() / "stats/da3/normalization_stats_level0.pt";
  const auto convert = [&](const std::filesystem::path& out) {
    return run({"convert", "--statistics-level0", level0, "--out", out.string()});
  };
  const auto run_folder = folder.path() / "run", other = folder.path() / "other",
             killed = folder.path() / "killed";
  for (const auto& path : {run_folder, other, killed}) std::filesystem::create_directory(path);
  { const RunJournal journal(run_folder); }
  write_file_atomically(other / "photo.jpg", "x");
  EXPECT_EQ(convert(run_folder).errors,
            "error: " + run_folder.string() +
                ": expected a bundle, or a new or empty folder, found a run folder; "
                "choose another --out.\n");
  EXPECT_EQ(convert(other).errors,
            "error: " + other.string() +
                ": expected a bundle, or a new or empty folder, found a folder with other "
                "files and no model.yaml; choose another --out.\n");
  const auto left = killed / (".level1.partial-" + std::to_string(::getpid()) + "-0.safetensors");
  write_file_atomically(left, "half");
  EXPECT_EQ(convert(killed).status, 0);
  EXPECT_FALSE(std::filesystem::exists(left));
}

}  // namespace
}  // namespace gld
