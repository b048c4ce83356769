// The manual that gld help --man prints and an installation has as gld(1).
#include "cli/manual_page.h"

#include "cli/commands.h"
#include "cli/help_text.h"

#include <sstream>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

TEST(ManualPage, HasEveryCommandAndOption) {
  const auto commands = all_commands();
  const auto outermost = outermost_types(commands);
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_command_line(commands, {"help", "--man"}), 0);
  const auto page = testing::internal::GetCapturedStdout();
  EXPECT_EQ(page, manual_page(commands, outermost));
  EXPECT_THAT(page, StartsWith(".TH GLD 1 "));
  for (const char* section : {"NAME\ngld \\- ", "SYNOPSIS\n", "DESCRIPTION\n", "COMMANDS\n", "EXIT STATUS\n"})
    EXPECT_THAT(page, HasSubstr(std::string(".SH ") + section));
  size_t at = page.find(".SH COMMANDS\n");
  const auto levels = all_levels(commands);
  for (size_t i = 0; i < levels.size(); ++i) {
    const auto heading = [](const Command& command) {
      return ".SS \"" + troff_text("gld " + command.name) + "\"\n";
    };
    at = page.find(heading(*levels[i]), at);
    ASSERT_NE(at, std::string::npos) << levels[i]->name;
    const size_t end = i + 1 < levels.size() ? page.find(heading(*levels[i + 1]), at + 1) : page.size();
    const auto section = page.substr(at, end - at);
    for (const Flag& flag : offered_flags(*levels[i], outermost)) {
      EXPECT_THAT(section, HasSubstr(".TP\n\\fB" + troff_text(shown_name(flag)) + "\\fR")) << levels[i]->name;
    }
  }
}

// No line is taken for a request that is none, and no heading ends early.
TEST(ManualPage, HasNoOtherRequestsThanItMeans) {
  EXPECT_EQ(troff_text(".nan of a-b\n'x\\y \"q\""), "\\&.nan of a\\-b\n\\&'x\\ey \\(dqq\\(dq");
  const auto commands = all_commands();
  std::istringstream page(manual_page(commands, outermost_types(commands)));
  size_t lines = 0;
  for (std::string line; std::getline(page, line); ++lines) {
    EXPECT_FALSE(line.empty());
    if (line[0] != '.' && line[0] != '\'') continue;
    EXPECT_THAT(line, testing::ContainsRegex("^\\.(TH|SH|SS|TP|PP|nh|ad l|br)( |$)|^\\.ad l$"));
  }
  EXPECT_GT(lines, 1000U);
}

}  // namespace
}  // namespace gld
