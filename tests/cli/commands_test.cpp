// What all commands of the program promise together.
#include "cli/commands.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "tests/cli/runnable_commands.h"
#include "tests/support/data_folders.h"
#include "train/stages/feature_stages.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::runnable_commands;

int quietly(const std::vector<std::string>& arguments) {
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  const int status = run_command_line(all_commands(), arguments);
  testing::internal::GetCapturedStdout();
  testing::internal::GetCapturedStderr();
  return status;
}

std::vector<std::string> words_of(const Command& command) {
  const auto space = command.name.find(' ');
  if (space == std::string::npos) return {command.name};
  return {command.name.substr(0, space), command.name.substr(space + 1)};
}

// The options of a run that is kept here, or of a model that was trained so, still mean what they say: a figure can be
// made anew by the command and the file beside it.
TEST(Commands, ReadTheConfigurationsOfRecordedRuns) {
  const auto runnable = runnable_commands();
  const std::string before = "# gld ", behind = ": the options of this run";
  // Their figures are why what they measured is gone: view pairs left out, and the two sampling benchmarks before one.
  const std::set<std::string> of_what_is_gone{"full_size_walk_visible", "sample_plan",
                                              "sample_plan_fresh_rooms"};
  int read = 0;
  for (const char* folder : {"docs/measured", "configs/tiny"}) {
    for (const auto& item : std::filesystem::recursive_directory_iterator(test::source_root() / folder)) {
      if (item.path().filename() != "config.yaml") continue;
      if (of_what_is_gone.count(item.path().parent_path().filename().string()) > 0) continue;
      const std::string text = read_file(item.path());
      ASSERT_EQ(text.rfind(before, 0), 0U) << item.path();
      const std::string name = text.substr(before.size(), text.find(behind) - before.size());
      const auto command = std::find_if(runnable.begin(), runnable.end(),
                                        [&](const Command& candidate) { return candidate.name == name; });
      ASSERT_NE(command, runnable.end()) << item.path() << " is of " << name;
      EXPECT_NO_THROW(load_yaml(*command->options, item.path())) << item.path();
      ++read;
    }
  }
  EXPECT_GT(read, 15);
}

// Each file of configs/train names its command in its head, and says of the paper's recipe what it has to say.
TEST(Commands, ReadTheRecipesOfThePaper) {
  int read = 0;
  for (const auto& item : std::filesystem::directory_iterator(test::source_root() / "configs/train")) {
    const std::string text = read_file(item.path()), file = item.path().filename().string();
    if (file == "model.yaml") continue;
    const auto at = text.find("# gld "), end = text.find(" --config configs/train/" + file);
    ASSERT_NE(at, std::string::npos) << file;
    ASSERT_LT(at, end) << file;
    const std::string name = text.substr(at + 6, end - at - 6);
    const auto runnable = runnable_commands();
    const auto command = std::find_if(runnable.begin(), runnable.end(),
                                      [&](const Command& candidate) { return candidate.name == name; });
    ASSERT_NE(command, runnable.end()) << file << " is of " << name;
    ASSERT_NO_THROW(load_yaml(*command->options, item.path())) << file;
    ++read;
    auto* train = dynamic_cast<TrainOptions*>(command->options.get());
    if (train == nullptr || name == "train backbone") continue;
    const bool decoder = name == "train decoder";
    const auto& loop = train->loop;
    EXPECT_EQ(loop.steps, decoder ? 170000 : 175000) << file;
    EXPECT_EQ(loop.micro_batches * train->data.loading.batch_size * (decoder ? train->data.views.views : 1),
              decoder ? 128 : 48)
        << file;
    EXPECT_EQ(train->data.longest_intervals,
              decoder ? (std::vector<int64_t>{128, 20}) : (std::vector<int64_t>{128, 20, 4, 20}))
        << file;
    EXPECT_EQ(train->data.weights, decoder ? (std::vector<double>{1, 1}) : (std::vector<double>{4, 4, 1, 1}))
        << file;
    EXPECT_EQ(train->data.loading.crop_centre, CropCentre::kPrincipalPoint) << file;
    EXPECT_EQ(loop.optimiser.ema_decay, decoder ? 0.9978 : 0.9995) << file;
    if (decoder) {
      EXPECT_EQ(dynamic_cast<TrainDecoderOptions*>(train)->objective.level_dropout, 0.5);
    } else {
      EXPECT_EQ(loop.learning_rate.peak, 5e-5) << file;
      EXPECT_EQ(train->data.views.order, ViewOrder::kShuffled) << file;
    }
  }
  EXPECT_EQ(read, 5);
  BundleOptions model;
  load_yaml(model, test::source_root() / "configs/train/model.yaml");
  check_options(model, "configs/train/model.yaml");
  for (const auto& part : model.generators) {
    EXPECT_EQ(part.time_shift.training, 0);
    EXPECT_EQ(part.dit.translation_unit, TranslationUnit::kLargestDistance);
  }
}

// A folder, a file or a number has one name and one declaration, whichever command takes it.
TEST(Commands, SharedOptionsAreTheSameEverywhere) {
  const std::set<std::string> shared{"out", "threads", "device", "seed", "scene", "scenes"};
  std::map<std::string, std::set<std::string>> declarations, defaults;
  for (const auto& command : runnable_commands()) {
    if (!command.options) continue;
    for (const auto& option : describe_options(*command.options)) {
      const std::string name = option.key.substr(option.key.rfind('.') + 1);
      EXPECT_NE(name, "folders") << command.name;
      if (shared.count(name) == 0) continue;
      // What a seed draws and what stands in for scenes is said behind the words that all have in common.
      std::string help = option.help;
      if (name == "seed") help = help.substr(0, 8) + help.substr(help.find(';'));
      if (name == "scenes") help = help.substr(0, help.find(';'));
      declarations[name].insert(option.type + " " + option.range + " " + help);
      // A stage of an ablation has one thread, because stages run side by side (the help of --jobs says so), and
      // training generates other scenes than gld synth does by default.
      const bool has_its_own =
          (name == "threads" && command.name == "ablate") || option.key == "data.synthetic.seed";
      if (has_its_own) {
        EXPECT_EQ(option.default_value, "1") << command.name;
      } else {
        defaults[name].insert(option.default_value);
      }
    }
  }
  EXPECT_EQ(declarations.size(), shared.size());
  for (const auto& [name, different] : declarations) {
    EXPECT_EQ(different.size(), 1U) << name << ": " << testing::PrintToString(different);
    EXPECT_EQ(defaults[name].size(), 1U) << name << ": " << testing::PrintToString(defaults[name]);
  }
}

// Of a plan the warnings are what matters, as of every command.
TEST(Commands, QuietShowsWarnings) {
  const auto scene = test::test_data() / "scenes" / "tartanair_hospital";
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  const int status = run_command_line(
      all_commands(),
      {"plan", "--quiet", "--model", (test::source_root() / "configs/tiny").string(), "--scene",
       scene.string(), "--sources", "0", "--targets", "1", "--size", "112x112", "--memory-limit", "0.001"});
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
  EXPECT_THAT(testing::internal::GetCapturedStderr(), testing::HasSubstr("warning: This takes "));
  EXPECT_EQ(status, 0);
}

// 0 for help, 2 for wrong usage: nothing was begun.
TEST(Commands, ExitStatusSaysWhatWentWrong) {
  for (const auto& command : runnable_commands()) {
    auto help = words_of(command), unknown = words_of(command);
    help.emplace_back("--help");
    unknown.emplace_back("--no-such-flag");
    EXPECT_EQ(quietly(help), 0) << command.name;
    EXPECT_EQ(quietly(unknown), 2) << command.name;
  }
  EXPECT_EQ(quietly({}), 2);
  EXPECT_EQ(quietly({"inspect", "/no/such/file"}), 1);
}

TEST(Commands, ThoseThatWriteAskForAFolderBeforeTheyBegin) {
  for (const auto& command : runnable_commands()) {
    if (!command.options || command.arguments.minimum > 0 || command.name == "plan") continue;
    const auto options = describe_options(*command.options);
    if (std::none_of(options.begin(), options.end(), [](const auto& option) { return option.key == "out"; }))
      continue;
    auto words = words_of(command);
    EXPECT_EQ(quietly(words), 2) << command.name;
  }
}

}  // namespace
}  // namespace gld
