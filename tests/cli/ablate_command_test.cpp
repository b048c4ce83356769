// This runs gld ablate from end to end, with the program itself: GLD_PROGRAM.
#include "gld/base/atomic_file.h"
#include "gld/base/child_process.h"
#include "gld/base/json_text.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <chrono>
#include <csignal>
#include <memory>
#include <regex>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using testing::HasSubstr;

// A training of seconds, evaluated two ways, and a second one put together with the first's parts.
const char* const kDescription = R"(title: A small ablation
seeds: [0, 1]
threads: 1
jobs: 2
stages:
  statistics:
    command: stats
    options: {scene_count: 2, data: {synthetic: {frames: 6, width: 56, height: 56}, views: {views: 3, shortest_interval: 1, longest_interval: 2, fewest_sources: 1, most_sources: 2}}}
  level:
    command: train level
    options:
      level: 1
      data: {synthetic: {frames: 6, width: 56, height: 56}, views: {views: 3, shortest_interval: 1, longest_interval: 2, fewest_sources: 1, most_sources: 2}, distinct_batches: 2, validation_scenes: 1}
      loop: {steps: 60, checkpoint_every: 1, log_every: 20, validate_every: 1000}
  whole: {command: assemble, model: statistics, parts: [level]}
  eval:
    command: eval
    options:
      synthetic: 2
      pictures: 0
      generator: {frames: 6, width: 56, height: 56}
      views: {views: 3, shortest_interval: 1, longest_interval: 2, fewest_sources: 1, most_sources: 1}
      solver: {evaluations: 2}
metrics:
  psnr: {column: sample_psnr}
variants:
  plain: {}
  guided: {options: {eval: {guidance: {guidance_scale: 3}}}}
claims:
  guidance: {metric: psnr, better: guided, worse: plain}
smoke:
  level: {loop: {steps: 2}}
)";

class AblateCommand : public testing::Test {
 protected:
  AblateCommand() {
    BundleOptions options = small_bundle_options();
    options.trained_sizes = {"56x56"};
    write_random_bundle(folder_.path() / "model", options, 1);
    write_file_atomically(folder_.path() / "a.yaml", kDescription);
  }

  std::vector<std::string> command(const std::vector<std::string>& more = {}) const {
    std::vector<std::string> words{
        GLD_PROGRAM, "ablate",       "--config", (folder_.path() / "a.yaml").string(),
        "--out",     run().string(), "--model",  (folder_.path() / "model").string()};
    words.insert(words.end(), more.begin(), more.end());
    return words;
  }
  fs::path run() const { return folder_.path() / "run"; }

  // Returns the exit status; what is printed stands in text_.
  int finish(ChildProcess& process) {
    while (!process.poll()) std::this_thread::sleep_for(milliseconds(10));
    text_ = read_file(log());
    return process.poll()->status;
  }
  int gld_ablate(const std::vector<std::string>& more = {}) {
    fs::remove(log());
    ChildProcess process(command(more), log(), -1);
    return finish(process);
  }
  fs::path log() const { return folder_.path() / "log.txt"; }

  // Returns the folders of the stages of that name in the cache.
  std::vector<fs::path> stages(const std::string& name) const {
    std::vector<fs::path> found;
    if (!fs::is_directory(run() / "cache")) return found;
    for (const auto& entry : fs::directory_iterator(run() / "cache")) {
      const auto file = entry.path() / "stage.json";
      if (!fs::exists(file)) continue;
      if (parse_json(read_file(file), file.string()).at("stage") == name) found.push_back(entry.path());
    }
    return found;
  }
  bool any_checkpoint() const {
    for (const auto& stage : stages("level")) {
      std::error_code error;
      for (const auto& entry : fs::directory_iterator(stage / "run" / "checkpoints", error)) {
        const std::string name =
            entry.path().filename().string();  // one that is being written begins with a dot
        if (name.rfind("step_", 0) == 0 && entry.path().extension() == ".safetensors") return true;
      }
    }
    return false;
  }

  test::TemporaryFolder folder_;
  std::string text_;
};

TEST_F(AblateCommand, GoesOnAfterItWasKilledAndRunsEveryStageOnce) {
  auto process = std::make_unique<ChildProcess>(command(), log(), -1);
  for (int tries = 0; tries < 80000 && !any_checkpoint() && !process->poll(); ++tries) {
    std::this_thread::sleep_for(milliseconds(5));
  }
  ASSERT_TRUE(any_checkpoint()) << read_file(log());
  ASSERT_EQ(::kill(process->id(), SIGKILL), 0);
  EXPECT_EQ(finish(*process), 128 + SIGKILL);
  EXPECT_FALSE(fs::exists(run() / "report.json"));

  // Its training ended with it; the next run goes on from the last checkpoint.
  EXPECT_EQ(gld_ablate(), 0) << text_;
  EXPECT_EQ(stages("statistics").size(), 1U);  // for both seeds and variants
  EXPECT_EQ(stages("level").size(), 2U);       // one a seed
  EXPECT_EQ(stages("eval").size(), 4U);
  int64_t resumed = 0;
  for (const auto& stage : stages("level")) {
    const auto report = parse_json(read_file(stage / "run" / "report.json"), "report.json");
    EXPECT_EQ(report.at("steps"), 60);
    if (report.at("steps_in_this_call") < 60) ++resumed;
  }
  EXPECT_GE(resumed, 1);

  const auto report = parse_json(read_file(run() / "report.json"), "report.json");
  EXPECT_EQ(report.at("claims").at(0).at("verdict"), "undecided");
  EXPECT_EQ(report.at("claims").at(0).at("reason"), "2 scenes, a verdict needs 64");
  EXPECT_EQ(report.at("claims").at(0).at("seeds"), 2);
  EXPECT_THAT(text_, HasSubstr("| claim"));
  for (const char* name : {"ablation.md", "ablation.csv", "ablation.svg", "ablation.png", "claims.svg",
                           "claims.png", "ablation.yaml", "config.yaml", "report.html", "progress.json"}) {
    EXPECT_TRUE(fs::is_regular_file(run() / name)) << name;
  }
  const std::string csv = read_file(run() / "ablation.csv");
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 1 + 2 * 2 * 2);

  // Everything is there: nothing runs again, and the result is the same.
  const std::string markdown = read_file(run() / "ablation.md");
  const auto made = fs::last_write_time(stages("statistics").front() / "done.json");
  EXPECT_EQ(gld_ablate(), 0) << text_;
  EXPECT_THAT(text_, HasSubstr("9 done, 0 to run"));
  EXPECT_EQ(fs::last_write_time(stages("statistics").front() / "done.json"), made);
  EXPECT_EQ(read_file(run() / "ablation.md"), markdown);
  EXPECT_EQ(gld_ablate({"--plan"}), 0);
  EXPECT_THAT(text_, HasSubstr("time left 0 s"));

  // Trainings that were removed are not run again for evaluations that are there.
  const auto level = stages("level").front();
  fs::remove_all(level);
  EXPECT_EQ(gld_ablate(), 0) << text_;
  EXPECT_THAT(text_, HasSubstr("0 to run"));
  EXPECT_FALSE(fs::exists(level));
  EXPECT_EQ(read_file(run() / "ablation.md").substr(0, 100), markdown.substr(0, 100));

  // What put a bundle together and was killed before it said so does it again.
  fs::remove(stages("whole").front() / "done.json");
  for (const auto& stage : stages("eval")) fs::remove_all(stage);
  EXPECT_EQ(gld_ablate(), 0) << text_;

  // Other weights under the same name are another question.
  BundleOptions other = small_bundle_options();
  other.trained_sizes = {"56x56"};
  fs::rename(folder_.path() / "model", folder_.path() / "first_model");
  write_random_bundle(folder_.path() / "model", other, 2);
  EXPECT_EQ(gld_ablate(), 1);
  EXPECT_THAT(text_,
              HasSubstr("expected the question whose results are there, found other weights in the model's "
                        "folder, or another file of a stage's config; choose another --out"));
  fs::remove_all(folder_.path() / "model");
  fs::rename(folder_.path() / "first_model", folder_.path() / "model");

  // Another question does not take the place of the answer that is there.
  const std::string answer = read_file(run() / "ablation.md");
  EXPECT_EQ(gld_ablate({"--seeds", "0"}), 1);
  EXPECT_THAT(
      text_,
      HasSubstr("expected the question whose results are there, found seeds [0] (it was [0, 1]); choose "
                "another --out, with --cache " +
                (run() / "cache").string() + " to take its finished stages"));
  EXPECT_EQ(read_file(run() / "ablation.md"), answer);

  EXPECT_EQ(gld_ablate({"--smoke", "--overwrite"}), 0) << text_;
  EXPECT_EQ(stages("level").size(), 1U);
  EXPECT_THAT(text_, HasSubstr("A smoke run"));
}

TEST_F(AblateCommand, StopsWhenItIsAskedToAndLosesNoStep) {
  ChildProcess process(command(), log(), -1);
  for (int tries = 0; tries < 80000 && !any_checkpoint() && !process.poll(); ++tries) {
    std::this_thread::sleep_for(milliseconds(5));
  }
  process.stop();
  EXPECT_EQ(finish(process), 130);
  EXPECT_THAT(text_, HasSubstr("interrupted: the ablation stopped with"));
  EXPECT_TRUE(any_checkpoint());
  for (const auto& stage : stages("level")) {
    if (fs::exists(stage / "run" / "checkpoints")) {
      EXPECT_THAT(read_file(stage / "log.txt"), HasSubstr("interrupted"));
    }
  }
}

TEST_F(AblateCommand, AStageThatFailsCostsItsVariantAlone) {
  std::string text = kDescription;
  const std::string before = "guided: {options: {eval: {guidance: {guidance_scale: 3}}}}";
  text.replace(text.find(before), before.size(),
               "guided: {options: {eval: {views: {views: 30, most_sources: 1}}}}");
  write_file_atomically(folder_.path() / "a.yaml", text);
  EXPECT_EQ(gld_ablate({"--smoke"}), 1);
  EXPECT_THAT(
      text_,
      HasSubstr("Not everything ran:\n\n- guided: stage 'eval' (guided, seed 0) ended with exit status 1: "));
  const auto report = parse_json(read_file(run() / "report.json"), "report.json");
  EXPECT_EQ(report.at("variants").at(0).at("metrics").at("psnr").at("scenes"), 2);
  EXPECT_TRUE(report.at("variants").at(1).at("metrics").at("psnr").at("mean").is_null());
}

TEST_F(AblateCommand, AColumnThatResultsDoNotHaveIsSaidWhenTheFirstOnesAreThere) {
  std::string text = kDescription;
  const std::string before = "psnr: {column: sample_psnr}";
  text.replace(text.find(before), before.size(), "psnr: {column: sample_pnsr}");
  write_file_atomically(folder_.path() / "a.yaml", text);
  EXPECT_EQ(gld_ablate({"--smoke", "--jobs", "2"}), 1);
  EXPECT_THAT(text_, HasSubstr("metric 'psnr' of variant '"));
  EXPECT_THAT(text_, HasSubstr("found 'sample_pnsr'; did you mean 'sample_psnr'?\n"));
  int64_t evaluations = 0;
  for (const auto& stage : stages("eval")) evaluations += fs::exists(stage / "done.json") ? 1 : 0;
  EXPECT_GE(evaluations, 1);  // the other one beside it was stopped, or was done too
  // Mended, the same command goes on with the stages that are done.
  write_file_atomically(folder_.path() / "a.yaml", kDescription);
  EXPECT_EQ(gld_ablate({"--smoke"}), 0) << text_;
}

TEST_F(AblateCommand, SeedsOfOtherRunsCountAsIfThisOneHadRunThem) {
  // Without the training: each seed draws noise of its own.
  std::string text = kDescription;
  text.replace(text.find("stages:\n"), text.find("  eval:\n") - text.find("stages:\n"), "stages:\n");
  text.replace(text.find("smoke:\n"), std::string::npos, "");
  write_file_atomically(folder_.path() / "a.yaml", text);
  const auto folder = [&](const std::string& name) { return (folder_.path() / name).string(); };
  const auto run_seeds = [&](const std::string& name, const std::string& seeds,
                             const std::vector<std::string>& more = {}) {
    fs::remove(log());
    std::vector<std::string> words{GLD_PROGRAM, "ablate",        "--config", folder("a.yaml"),
                                   "--out",     folder(name),    "--model",  folder("model"),
                                   "--cache",   folder("cache"), "--seeds",  seeds};
    words.insert(words.end(), more.begin(), more.end());
    ChildProcess process(words, log(), -1);
    return finish(process);
  };
  const auto report_of = [&](const std::string& name) {
    return parse_json(read_file(folder_.path() / name / "report.json"), "report.json");
  };
  ASSERT_EQ(run_seeds("together", "0,1"), 0) << text_;
  ASSERT_EQ(run_seeds("zero", "0"), 0) << text_;
  ASSERT_EQ(run_seeds("one", "1", {"--with-runs", folder("zero")}), 0) << text_;
  EXPECT_EQ(read_file(folder_.path() / "one" / "ablation.csv"),
            read_file(folder_.path() / "together" / "ablation.csv"));
  EXPECT_EQ(report_of("one").at("claims"), report_of("together").at("claims"));
  EXPECT_EQ(report_of("one").at("variants"), report_of("together").at("variants"));
  EXPECT_EQ(report_of("one").at("other_runs").at(0).at("seeds"), nlohmann::json::array({0}));
  EXPECT_EQ(report_of("one").at("stages").size(), 2U);
  EXPECT_THAT(text_, HasSubstr("Seeds that other runs of the same question measured"));

  // What cannot be counted together is refused before anything runs.
  EXPECT_EQ(run_seeds("two", "0,2", {"--with-runs", folder("zero")}), 2);
  EXPECT_EQ(text_, "error: --with-runs: expected every seed once, found seed 0 of '" + folder("zero") +
                       "', which is this ablation's too; choose other --seeds, or leave the folder out.\n");
  EXPECT_EQ(run_seeds("two", "2", {"--with-runs", folder("zero") + "," + folder("together")}), 2);
  EXPECT_EQ(text_, "error: --with-runs: expected every seed once, found seed 0 of '" + folder("together") +
                       "', which is that of '" + folder("zero") +
                       "' too; choose other --seeds, or leave the folder out.\n");
  EXPECT_EQ(
      run_seeds("two", "2", {"--with-runs", folder("zero"), "--overrides", "eval.solver.evaluations=3"}), 2);
  EXPECT_EQ(
      text_,
      "error: --with-runs: expected stage 'eval' as it is here in everything but its seed, found another one in '" +
          folder("zero") +
          "'; give it the same description, model, --overrides, --threads and --smoke, or leave the folder out.\n");
  write_file_atomically(folder_.path() / "a.yaml",
                        std::regex_replace(text, std::regex("sample_psnr"), "reconstruction_psnr"));
  EXPECT_EQ(run_seeds("two", "2", {"--with-runs", folder("zero")}), 2);
  EXPECT_EQ(
      text_,
      "error: --with-runs: expected the same numbers, of variant 'guided' metric psnr: "
      R"({"better":"higher","column":"reconstruction_psnr"}, found {"better":"higher","column":"sample_psnr"} in ')" +
          folder("zero") + "'; give it the same description, or leave the folder out.\n");
  // The same stages, under each other's names.
  write_file_atomically(
      folder_.path() / "a.yaml",
      std::regex_replace(std::regex_replace(std::regex_replace(text, std::regex("  plain:"), "  other:"),
                                            std::regex("  guided:"), "  plain:"),
                         std::regex("  other:"), "  guided:"));
  EXPECT_EQ(run_seeds("two", "2", {"--with-runs", folder("zero")}), 2);
  EXPECT_EQ(
      text_,
      "error: --with-runs: expected variant 'guided' as it is here in everything but its seed, found another one of "
      "that name in '" +
          folder("zero") +
          "'; give it the same description, model, --overrides, --threads and --smoke, or leave the folder out.\n");
  write_file_atomically(folder_.path() / "a.yaml", text);
  EXPECT_EQ(run_seeds("two", "2", {"--with-runs", folder("three")}), 2);
  EXPECT_EQ(text_,
            "error: --with-runs: expected the run folder of a finished gld ablate, found '" +
                folder("three") +
                "' without report.json and ablation.csv; let that ablation end, or leave the folder out.\n");
  const std::string report = read_file(folder_.path() / "zero" / "report.json");
  for (const char* other : {"{}", R"({"seeds": ["0"], "variants": [], "stages": []})"}) {
    write_file_atomically(folder_.path() / "zero" / "report.json", other);
    EXPECT_EQ(run_seeds("two", "2", {"--with-runs", folder("zero")}), 1);
    EXPECT_EQ(
        text_,
        "error: " + folder("zero/report.json") +
            ": expected the report of gld ablate, found another file; give --with-runs folders that gld "
            "ablate wrote.\n");
  }
  write_file_atomically(folder_.path() / "zero" / "report.json", report);
  ASSERT_EQ(run_seeds("plain", "3", {"--only", "plain"}), 0) << text_;
  EXPECT_EQ(run_seeds("two", "2", {"--with-runs", folder("plain")}), 2);
  EXPECT_THAT(text_, HasSubstr("expected stage 'eval' as it is here"));
  EXPECT_FALSE(fs::exists(folder_.path() / "two"));
}

TEST_F(AblateCommand, SaysWhatIsWrongBeforeAnythingRuns) {
  EXPECT_EQ(gld_ablate({"--only", "gided"}), 2);
  EXPECT_EQ(text_,
            "error: --only: expected a variant of this ablation, found 'gided'; did you mean 'guided'?\n");
  EXPECT_EQ(gld_ablate({"--overrides", "eval.synthetc=3"}), 2);
  EXPECT_EQ(
      text_,
      "error: --overrides, stage 'eval', key 'synthetc': expected a known option, found an unknown one; did you mean "
      "'synthetic'?\n");
  EXPECT_EQ(gld_ablate({"--overrides", "eval.scenes=no/such/folder"}), 1);
  EXPECT_EQ(
      text_.substr(text_.find("variant")),
      "variant 'plain', stage 'eval', key 'scenes': expected a folder that exists, found 'no/such/folder'; say where it "
      "is with --overrides eval.scenes=FOLDER.\n");
  fs::remove(log());
  ChildProcess without({GLD_PROGRAM, "ablate", "--out", run().string()}, log(), -1);
  EXPECT_EQ(finish(without), 2);
  EXPECT_EQ(
      text_,
      "error: --config: expected the description of an ablation, found nothing; add for example --config "
      "configs/ablations/sources.yaml.\n");
  EXPECT_FALSE(fs::exists(run()));
}

}  // namespace
}  // namespace gld
