// What shells complete behind "gld", asked of bash itself.
#include "cli/completion_script.h"

#include "cli/commands.h"
#include "gld/base/atomic_file.h"
#include "tests/support/temporary_folder.h"

#include <array>
#include <cstdio>
#include <filesystem>
#include <sstream>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

namespace gld {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;

struct Shell {
  int status = 0;
  std::string output;
};

// The output is both standard output and error.
Shell run_shell(const std::string& words) {
  Shell shell;
  FILE* pipe = ::popen((words + " 2>&1").c_str(), "r");
  if (pipe == nullptr) return {-1, "no shell"};
  std::array<char, 4096> buffer{};
  for (size_t count = 0; (count = std::fread(buffer.data(), 1, buffer.size(), pipe)) > 0;)
    shell.output.append(buffer.data(), count);
  const int status = ::pclose(pipe);
  shell.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return shell;
}

class Completion : public testing::Test {
 protected:
  Completion() : commands_(all_commands()), outermost_(outermost_types(commands_)) {
    write_file_atomically(folder_.path() / "gld.bash", bash_completion(commands_, outermost_));
  }

  // Returns what bash offers for the last of the words, as it divides a line; the function is that which "complete"
  // names.
  std::vector<std::string> offered(const std::vector<std::string>& words) {
    std::string script = "source ./gld.bash\ncomplete -p gld >/dev/null || exit 3\nCOMP_WORDS=(";
    for (const auto& word : words) script += " '" + word + "'";
    script += ")\nCOMP_CWORD=" + std::to_string(words.size() - 1) +
              "\n_gld || exit 4\nfor word in \"${COMPREPLY[@]}\"; do echo \"$word\"; done\n";
    write_file_atomically(folder_.path() / "ask.bash", script);
    const auto shell = run_shell("cd '" + folder_.path().string() + "' && bash -c 'source ./ask.bash'");
    EXPECT_EQ(shell.status, 0) << shell.output;
    std::vector<std::string> lines;
    std::istringstream stream(shell.output);
    for (std::string line; std::getline(stream, line);) lines.push_back(line);
    return lines;
  }

  test::TemporaryFolder folder_;
  std::vector<Command> commands_;
  OutermostTypes outermost_;
};

TEST_F(Completion, OfCommands) {
  const auto names = offered({"gld", ""});
  for (const auto& command : commands_) EXPECT_THAT(names, Contains(command.name));
  EXPECT_THAT(names, Contains("help"));
  EXPECT_THAT(offered({"gld", "sam"}), ElementsAre("sample"));
  EXPECT_THAT(offered({"gld", "train", ""}), ElementsAre("backbone", "decoder", "depth", "blending", "level",
                                                         "cascade", "refiner", "sample-refiner"));
  EXPECT_THAT(offered({"gld", "help", "train", "l"}), ElementsAre("level"));
  EXPECT_THAT(offered({"gld", "completion", ""}), ElementsAre("bash", "zsh", "fish"));
}

// This goes over every flag of every command, in its one spelling.
TEST_F(Completion, OfFlags) {
  for (const Command* command : all_levels(commands_)) {
    if (!command->options) continue;
    std::vector<std::string> words{"gld"};
    std::istringstream name(command->name);
    for (std::string word; name >> word;) words.push_back(word);
    words.emplace_back("--");
    const auto names = offered(words);
    const auto flags = offered_flags(*command, outermost_);
    EXPECT_EQ(names.size(), flags.size() + common_flags().size() + 2) << command->name;
    for (const Flag& flag : flags) {
      const bool on = flag.is_switch() && flag.default_value == "true";
      EXPECT_THAT(names, Contains(on ? "--no-" + flag.shown.substr(2) : flag.shown)) << command->name;
    }
  }
  const auto begun = offered({"gld", "sample", "--quiet", "--out", "x", "--ta"});
  EXPECT_THAT(begun, ElementsAre("--targets"));
}

TEST_F(Completion, OfValues) {
  EXPECT_THAT(offered({"gld", "sample", "--quality", ""}),
              ElementsAre("options", "published", "exact", "fast"));
  EXPECT_THAT(offered({"gld", "sample", "--solver.solver", "unipc"}), ElementsAre("unipc2", "unipc3"));
  EXPECT_THAT(offered({"gld", "sample", "--solver", "=", "unipc"}), ElementsAre("unipc2", "unipc3"));
  EXPECT_THAT(offered({"gld", "sample", "--solver", "="}), Contains("euler"));
  EXPECT_THAT(offered({"gld", "sample", "--seed", ""}), IsEmpty());
}

TEST_F(Completion, OfFilesAlsoWithBlanks) {
  std::filesystem::create_directories(folder_.path() / "my scene");
  write_file_atomically(folder_.path() / "my model.pt", "");
  EXPECT_THAT(offered({"gld", "sample", "--scene", "my"}),
              testing::UnorderedElementsAre("my scene", "my model.pt"));
  EXPECT_THAT(offered({"gld", "inspect", "my m"}), ElementsAre("my model.pt"));
  EXPECT_THAT(offered({"gld", "sample", "--config", "ask"}), ElementsAre("ask.bash"));
  EXPECT_THAT(offered({"gld", "sample", "my"}), IsEmpty());
}

// Where these shells are there, they say whether they read it; what it holds is looked at everywhere.
TEST_F(Completion, OfOtherShellsIsReadByThem) {
  const auto zsh = zsh_completion(commands_, outermost_), fish = fish_completion(commands_, outermost_);
  EXPECT_THAT(zsh, StartsWith("#compdef gld\n"));
  EXPECT_THAT(zsh, HasSubstr("'gld sample --quality') compadd -- options published exact fast; return ;;"));
  EXPECT_THAT(
      fish, HasSubstr("complete -c gld -n '__gld_at \\'gld sample\\'' -l 'quality' -x -a 'options published "
                      "exact fast' -d "));
  for (const Command* command : all_levels(commands_)) {
    EXPECT_THAT(zsh, HasSubstr("    'gld " + command->name + "')\n"));
    for (const Flag& flag : offered_flags(*command, outermost_)) {
      const bool on = flag.is_switch() && flag.default_value == "true";
      const std::string name = on ? "--no-" + flag.shown.substr(2) : flag.shown;
      EXPECT_THAT(zsh, HasSubstr(" '" + name + ":"));
      EXPECT_THAT(fish, HasSubstr("__gld_at \\'gld " + command->name + "\\'' -l '" + name.substr(2) + "'"));
    }
  }
  write_file_atomically(folder_.path() / "gld.zsh", zsh);
  write_file_atomically(folder_.path() / "gld.fish", fish);
  for (const char* shell : {"bash", "zsh", "fish"}) {
    const auto read = run_shell("cd '" + folder_.path().string() + "' && if command -v " + shell +
                                " >/dev/null; then " + shell + " -n gld." + shell + "; fi");
    EXPECT_EQ(read.status, 0) << shell << ": " << read.output;
    EXPECT_EQ(read.output, "") << shell;
  }
}

TEST_F(Completion, OfAnUnknownShellIsRefused) {
  testing::internal::CaptureStderr();
  EXPECT_EQ(run_command_line(commands_, {"completion", "csh"}), 1);
  EXPECT_EQ(testing::internal::GetCapturedStderr(),
            "error: gld completion: expected bash, zsh or fish, found 'csh'; name one of them.\n");
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_command_line(commands_, {"completion", "bash"}), 0);
  EXPECT_EQ(testing::internal::GetCapturedStdout(), bash_completion(commands_, outermost_));
}

}  // namespace
}  // namespace gld
