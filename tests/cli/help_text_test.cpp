// What gld COMMAND --help and --help-all show, of every command of the program.
#include "cli/help_text.h"

#include "cli/commands.h"
#include "gld/base/configuration.h"
#include "tests/cli/runnable_commands.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::EndsWith;
using testing::HasSubstr;

std::vector<std::string> lines_of(const std::string& text) {
  std::istringstream stream(text);
  std::vector<std::string> lines;
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

// Returns the name that an option's line begins with, "--[no-]ema" as "--ema"; empty for other lines.
std::string option_of(const std::string& line) {
  if (line.rfind("  --", 0) != 0) return "";
  const std::string name = line.substr(2, line.find(' ', 2) - 2);
  return name.rfind("--[no-]", 0) == 0 ? "--" + name.substr(7) : name;
}

std::map<std::string, int> options_of(const std::string& help) {
  std::map<std::string, int> times;
  for (const auto& line : lines_of(help)) {
    if (!option_of(line).empty()) ++times[option_of(line)];
  }
  return times;
}

std::string printed(const std::vector<std::string>& words) {
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_command_line(all_commands(), words), 0) << testing::PrintToString(words);
  return testing::internal::GetCapturedStdout();
}

TEST(HelpText, OfEveryCommandIsOnePageAndSaysWhereTheRestIs) {
  const auto commands = all_commands();
  const auto outermost = outermost_types(commands);
  for (const Command* command : all_levels(commands)) {
    std::istringstream name(command->name);
    std::vector<std::string> words{std::istream_iterator<std::string>(name), {}};
    words.emplace_back("--help");
    const auto help = printed(words);
    EXPECT_LE(lines_of(help).size(), kMostLinesOfHelp) << help;
    if (!command->options) continue;
    EXPECT_EQ(help, short_help(*command, outermost));
    // Each option is there once, and so many more as the last line says.
    const auto shown = options_of(help);
    for (const auto& [option, times] : shown) EXPECT_EQ(times, 1) << command->name << " " << option;
    const size_t all = offered_flags(*command, outermost).size() + common_flags().size();
    EXPECT_THAT(help, EndsWith("\n" + std::to_string(all - shown.size()) +
                               " more options, with type, range and default: gld " + command->name +
                               " --help-all\n"));
  }
  EXPECT_LE(lines_of(printed({"--help"})).size(), kMostLinesOfHelp);
}

// In one spelling: "--solver.evaluations" has its heading, and is taken all the same.
TEST(HelpText, OfAllOptionsHasEachExactlyOnce) {
  const auto outermost = outermost_types(all_commands());
  for (const auto& command : test::runnable_commands()) {
    if (!command.options) continue;
    const auto help = full_help(command, outermost);
    const auto shown = options_of(help);
    for (const auto& [option, times] : shown) EXPECT_EQ(times, 1) << command.name << " " << option;
    const auto flags = offered_flags(command, outermost);
    EXPECT_LE(flags.size(), describe_options(*command.options).size());
    // --help has a line here too.
    EXPECT_EQ(shown.size(), flags.size() + common_flags().size() + 1) << command.name;
    for (const Flag& flag : flags) {
      EXPECT_EQ(shown.count(flag.shown), 1U) << command.name << " " << flag.shown;
      EXPECT_THAT(help, HasSubstr(type_of_value(flag)));
    }
    for (const auto& group : group_flags(command, outermost)) {
      if (!group.key.empty() && group.key.find('_') == std::string::npos) {
        EXPECT_THAT(help, HasSubstr("\n--" + group.key + ".*")) << command.name;
      }
    }
  }
  const auto commands = all_commands();
  for (const Command* command : all_levels(commands)) {
    if (command->name != "splat render") continue;
    EXPECT_EQ(printed({"splat", "render", "--help-all"}), full_help(*command, outermost));
  }
}

TEST(HelpText, OffersNothingThatNothingLooksAt) {
  const auto plan = printed({"plan", "--help-all"}), sample = printed({"sample", "--help-all"});
  for (const char* of_a_run : {"--out", "--overwrite", "--resume"}) {
    EXPECT_THAT(sample, HasSubstr(std::string("\n  ") + of_a_run + " "));
    EXPECT_THAT(plan, testing::Not(HasSubstr(std::string("\n  ") + of_a_run + " ")));
  }
  EXPECT_THAT(plan, HasSubstr("\n  --targets "));
}

TEST(HelpText, ShowsOptionsThatTheCommandHas) {
  for (const auto& command : test::runnable_commands()) {
    if (!command.options) continue;
    const auto options = describe_options(*command.options);
    for (const auto& usual : command.usual) {
      EXPECT_FALSE(usual.keys.empty());
      for (const auto& key : usual.keys) {
        EXPECT_TRUE(std::any_of(options.begin(), options.end(),
                                [&](const OptionDescription& option) { return option.key == key; }))
            << command.name << " has no option " << key;
      }
    }
  }
}

TEST(HelpText, IsCutAtAClause) {
  EXPECT_EQ(first_clause("one; two", 20), "one; two");
  EXPECT_EQ(first_clause("what finds cameras: colmap, features", 20), "what finds cameras");
  EXPECT_EQ(first_clause("pixels (of a side) of pictures", 18), "pixels");
  EXPECT_EQ(first_clause("stages that run at a time; 0: as many as cores", 40), "stages that run at a time");
  EXPECT_EQ(first_clause("as many words as there are", 17), "as many words ...");
}

}  // namespace
}  // namespace gld
