#include "cli/option_uses.h"

#include "cli/commands.h"
#include "gld/base/configuration.h"
#include "gld/base/dashed_name.h"
#include "tests/cli/runnable_commands.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::runnable_commands;

// Returns the key of the option that a rule needs, as refuse_without_effect() finds it.
std::string needed_key(const OptionUse& use, const Command& command, const std::string& key) {
  const std::string group = key.substr(0, key.rfind('.') + 1);
  std::string any;
  for (const auto& option : describe_options(*command.options)) {
    if (option.key == group + use.needs) return option.key;
    const std::string end = "." + use.needs;
    const bool named =
        option.key == use.needs || (option.key.size() > end.size() &&
                                    option.key.compare(option.key.size() - end.size(), end.size(), end) == 0);
    if (any.empty() && named) any = option.key;
  }
  return any;
}

// Returns a value with which nothing looks at the option; none where the default is one.
std::string value_without_use(const OptionUse& use, const Command& command, const std::string& needed) {
  if (use.condition == OptionUse::Condition::kNoneOf) return use.values.front();
  for (const auto& option : describe_options(*command.options)) {
    if (option.key != needed) continue;
    if (option.type == "list of integer") return "1";
    if (option.type.rfind("list", 0) == 0 || option.type == "text") return "some_folder";
    for (size_t begin = 0; begin != std::string::npos;) {
      const size_t bar = option.type.find('|', begin);
      std::string name = option.type.substr(begin, bar - begin);
      if (std::find(use.values.begin(), use.values.end(), name) == use.values.end()) return name;
      begin = bar == std::string::npos ? bar : bar + 1;
    }
  }
  return "";
}

// Each rule is of options that there are, and refuses each of them in each command that has it.
TEST(OptionUses, EveryRuleRefusesWhatHasNoEffect) {
  for (const OptionUse& use : option_uses()) {
    int refused = 0;
    const auto number_of_options = [&](const Command& command) {
      return command.options ? describe_options(*command.options).size() : 0;
    };
    const auto commands = runnable_commands();
    for (size_t which = 0; which < commands.size(); ++which) {
      for (size_t i = 0; i < number_of_options(commands[which]); ++i) {
        const Command command = runnable_commands()[which];  // with its defaults
        const std::string key = describe_options(*command.options)[i].key;
        if (!applies_to(use, command, key)) continue;
        if (!use.needs.empty()) {
          const std::string needed = needed_key(use, command, key);
          ASSERT_NE(needed, "") << command.name << " " << key << " needs " << use.needs;
          const std::string value = value_without_use(use, command, needed);
          if (!value.empty()) apply_setting(*command.options, fmt::format("{}={}", needed, value));
        }
        const std::string flag = "--" + dashed_name(key);
        EXPECT_THAT(test::error_of([&] {
                      refuse_without_effect(command, {{key, flag}});
                    }),
                    testing::StartsWith(flag + ": expected "))
            << command.name;
        ++refused;
      }
    }
    EXPECT_GT(refused, 0) << use.command << " " << use.key;
  }
}

// For each option of each command a value that it cannot have is refused under the name of its flag, before anything
// else is looked at.
TEST(OptionUses, EveryOptionRefusesAValueThatItCannotHave) {
  int refused = 0;
  for (const auto& command : runnable_commands()) {
    if (!command.options) continue;
    for (const auto& option : describe_options(*command.options)) {
      const std::string flag = "--" + dashed_name(option.key);
      std::vector<std::string> words;
      for (size_t begin = 0; begin != std::string::npos;) {
        const size_t space = command.name.find(' ', begin);
        words.push_back(command.name.substr(begin, space - begin));
        begin = space == std::string::npos ? space : space + 1;
      }
      for (size_t i = 0; i < command.arguments.minimum; ++i) words.emplace_back("argument");
      const bool text = option.type == "text" || option.type == "list of text";
      words.push_back(flag + "=" + (text ? "" : "no_such_value"));
      testing::internal::CaptureStdout();
      testing::internal::CaptureStderr();
      EXPECT_EQ(run_command_line(all_commands(), words), 2) << command.name << " " << flag;
      testing::internal::GetCapturedStdout();
      const std::string said = testing::internal::GetCapturedStderr();
      EXPECT_THAT(
          said,
          testing::MatchesRegex(
              "error: (--[a-z0-9.-]+: expected|gld [a-z -]+: expected a value behind --[a-z0-9.-]+,) .*[.?]\n"))
          << command.name << " " << flag;
      ++refused;
    }
  }
  EXPECT_GT(refused, 300);
}

}  // namespace
}  // namespace gld
