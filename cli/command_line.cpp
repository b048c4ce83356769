#include "cli/command.h"
#include "cli/flag_list.h"
#include "cli/help_text.h"
#include "cli/manual_page.h"
#include "cli/option_uses.h"
#include "cli/version_text.h"
#include "gld/base/configuration.h"
#include "gld/base/dashed_name.h"
#include "gld/base/error.h"
#include "gld/base/flag_values.h"
#include "gld/base/interrupt.h"
#include "gld/base/printable_text.h"
#include "gld/report/progress.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <new>
#include <optional>
#include <set>

#include <c10/util/Exception.h>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

constexpr int kFailed = 1;
constexpr int kWrongUsage = 2;

struct FlagValue {
  std::string key;
  std::string value;
  std::string flag;  // as it is shown: "--sources"
};

// What the command line said about the options, before it is applied in the documented order.
struct Collected {
  std::string config_file;
  bool quiet = false;
  std::vector<std::string> settings;
  std::vector<FlagValue> flags;
};

// Returns "--solver.evaluations,--evaluations": the short form is there only where it is unambiguous.
std::string flag_names(const Flag& flag, const std::string& prefix) {
  std::string names = prefix + flag.full.substr(2);
  if (flag.has_short_form()) names += "," + prefix + flag.shown.substr(2);
  return names;
}

constexpr const char* kSetFlag = "--set";

void add_flags(CLI::App& app, const Command& command, const OutermostTypes& outermost, Collected& collected) {
  app.add_option("--config", collected.config_file);
  app.add_option(kSetFlag, collected.settings)->allow_extra_args(false);
  app.add_flag("--quiet", collected.quiet);
  for (const Flag& flag : list_flags(command, outermost)) {
    const std::string key = flag.key, shown = flag.shown;
    if (flag.is_switch()) {
      app.add_flag_function(flag_names(flag, "--") + "," + flag_names(flag, "!--no-"),
                            [&collected, key, shown](int64_t count) {
                              collected.flags.push_back({key, count > 0 ? "true" : "false", shown});
                            })
          ->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
      continue;
    }
    app.add_option_function<std::string>(flag_names(flag, "--"),
                                         [&collected, key, shown](const std::string& value) {
                                           collected.flags.push_back({key, value, shown});
                                         })
        ->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
  }
}

std::vector<std::string> known_flags(const CLI::App& app) {
  std::vector<std::string> names;
  for (const auto* option : app.get_options()) {
    for (const auto& name : option->get_lnames()) names.push_back("--" + name);
  }
  return names;
}

// Returns the shortest of those that begin so, "--model" for "--mod"; it is empty where the beginning is a letter or
// none begins so.
std::string begun_name(const std::string& beginning, const std::vector<std::string>& known) {
  constexpr size_t kFewestLetters = 2;
  std::string shortest;
  if (beginning.size() - std::min(beginning.find_first_not_of('-'), beginning.size()) < kFewestLetters)
    return "";
  for (const auto& name : known) {
    if (name.compare(0, beginning.size(), beginning) != 0) continue;
    if (shortest.empty() || name.size() < shortest.size()) shortest = name;
  }
  return shortest;
}

// Returns what a wrong name was perhaps meant to be: one that begins so, or else the nearest.
std::string meant_name(const std::string& name, const std::vector<std::string>& known) {
  const std::string begun = begun_name(name, known);
  return begun.empty() ? nearest_name(name, known) : begun;
}

// Returns the shortest flag whose last word that is, "--solver.schedule.grid" for "--grid" where several groups have
// one; else it is as of any name.
std::string flag_like(const std::string& flag, const std::vector<std::string>& known) {
  if (flag.rfind("--", 0) == 0) {
    const std::string end = "." + flag.substr(2);
    std::string shortest;
    for (const auto& name : known) {
      if (name.size() <= end.size() || name.compare(name.size() - end.size(), end.size(), end) != 0) continue;
      if (shortest.empty() || name.size() < shortest.size()) shortest = name;
    }
    if (!shortest.empty()) return shortest;
    // For a group's name it is its first options, "--loop.learning-rate.peak" among them for "--learning-rate".
    constexpr size_t kNamed = 3;
    const std::string group = "." + flag.substr(2) + ".";
    std::vector<std::string> inner;
    for (const auto& name : known) {
      if (name.find(group) != std::string::npos && inner.size() < kNamed) inner.push_back(name);
    }
    if (!inner.empty()) return fmt::format("{}", fmt::join(inner, " or "));
  }
  return meant_name(flag, known);
}

// Makes of "--photos a.jpg b.jpg" "--photos a.jpg,b.jpg", which a shell makes of *.jpg: a flag that takes a list takes
// what follows it up to the next flag. It does not do so in commands that take arguments without a flag.
std::vector<std::string> with_lists_joined(const CLI::App& app, const Command& command,
                                           const std::vector<std::string>& arguments) {
  if (!command.options || command.arguments.maximum > 0) return arguments;
  std::set<std::string> lists;
  for (const auto& description : describe_options(*command.options)) {
    if (description.type.rfind("list", 0) != 0) continue;
    const auto* option = app.get_option_no_throw("--" + dashed_name(description.key));
    if (option == nullptr) continue;
    for (const auto& name : option->get_lnames()) lists.insert("--" + name);
  }
  std::vector<std::string> joined;
  bool in_list = false, has_value = false;
  for (const auto& argument : arguments) {
    // A number may be negative.
    const bool is_flag = argument.size() > 1 && argument[0] == '-' && argument[1] != '.' &&
                         (argument[1] < '0' || argument[1] > '9');
    if (in_list && !is_flag && has_value) {
      joined.back() += "," + argument;
      continue;
    }
    has_value = in_list && !is_flag;
    if (is_flag) {
      const size_t equals = argument.find('=');
      in_list = lists.count(argument.substr(0, equals)) > 0;
      has_value = in_list && equals != std::string::npos;
    }
    joined.push_back(argument);
  }
  return joined;
}

void refuse_unknown(const Command& command, const CLI::App& app, const std::vector<std::string>& left_over) {
  for (const auto& argument : left_over) {
    if (argument.size() < 2 || argument[0] != '-') continue;
    const std::string flag = argument.substr(0, argument.find('='));
    const auto near = flag_like(flag, known_flags(app));
    fail({"gld " + command.name, "a known flag", "'" + flag + "'",
          near.empty() ? "see gld " + command.name + " --help" : "did you mean " + near + "?"});
  }
}

// Which of two values is meant cannot be known; --set takes many, each for another key.
void refuse_repeated(const Command& command, const CLI::App& app, const Collected& collected) {
  const auto refuse = [&](const std::string& what, size_t times) {
    fail({"gld " + command.name, what + " once", std::to_string(times) + " times", "leave out all but one"});
  };
  for (const auto* option : app.get_options()) {
    if (option->count() > 1 && !option->check_name(kSetFlag)) {
      refuse("--" + option->get_lnames().front(), option->count());
    }
  }
  std::map<std::string, size_t> keys;
  for (const auto& setting : collected.settings) {
    const std::string key = setting.substr(0, setting.find('='));
    if (++keys[key] > 1) refuse("--set " + key, keys[key]);
  }
}

void require_argument_count(const Command& command, const std::vector<std::string>& given) {
  const Arguments& arguments = command.arguments;
  const size_t count = given.size();
  if (count >= arguments.minimum && count <= arguments.maximum) return;
  const std::string expected =
      arguments.maximum == 0 ? "no argument without a flag"
      : arguments.minimum == arguments.maximum
          ? std::to_string(arguments.minimum) + " argument(s): " + arguments.usage
      : arguments.minimum == 0
          ? "at most " + std::to_string(arguments.maximum) + " argument(s): " + arguments.usage
          : "at least " + std::to_string(arguments.minimum) + " argument(s): " + arguments.usage;
  const std::string found = arguments.maximum == 0 ? "'" + given.front() + "'" : std::to_string(count);
  fail({"gld " + command.name, expected, found, "see gld " + command.name + " --help"});
}

// Mostly of a shell's variable that is not set: taken for the default, it would mean something else than was asked for.
[[noreturn]] void refuse_empty(const std::string& flag) {
  fail({flag, "a value", "an empty text", "leave it out for the default, or write --set KEY=\"\" or KEY=[]"});
}

// A file of options says in its first line whose they are, in recipes and in every run folder: "# gld train level:
// ...".
std::string command_of_recipe(const std::string& file) {
  std::ifstream stream(file);
  std::string first;
  std::getline(stream, first);
  const std::string begin = "# gld ";
  if (first.rfind(begin, 0) != 0) return "";
  size_t end = first.size();
  for (const char* behind : {":", " in ", " --", "."}) end = std::min(end, first.find(behind));
  return first.substr(begin.size(), end - begin.size());
}

void load_recipe(const Command& command, const std::string& file) {
  try {
    load_yaml(*command.options, file);
  } catch (const Error&) {
    const std::string other = command_of_recipe(file);
    if (other.empty() || other == command.name) throw;
    fail({file, "options of gld " + command.name, "those of gld " + other + ", as its first line says",
          "give a file of gld " + command.name + ", or run gld " + other});
  }
}

void apply(const Collected& collected, const Command& command) {
  OptionsGroup& options = *command.options;
  if (!collected.config_file.empty()) {
    if (command.read_config) {
      command.read_config(collected.config_file);
    } else {
      load_recipe(command, collected.config_file);
    }
  }
  for (const auto& setting : collected.settings) {
    if (!setting.empty() && setting.find('=') == setting.size() - 1) refuse_empty("--set " + setting);
    apply_setting(options, setting);
  }
  for (const auto& flag : collected.flags) {
    if (flag.value.empty()) refuse_empty(flag.flag);
    apply_flag(options, flag.key, flag.value, flag.flag);
  }
}

std::vector<NamedOption> named_options(const Collected& collected) {
  std::vector<NamedOption> named;
  for (const auto& setting : collected.settings) {
    const std::string key = setting.substr(0, setting.find('='));
    named.push_back({key, std::string(kSetFlag) + " " + key});
  }
  for (const auto& flag : collected.flags) named.push_back({flag.key, flag.flag});
  return named;
}

std::vector<std::string> keys_of(const std::vector<NamedOption>& named) {
  std::vector<std::string> keys;
  keys.reserve(named.size());
  for (const auto& option : named) keys.push_back(option.key);
  return keys;
}

// Refuses "--resume=maybe", which the parser would take for a number. true and false are what files have.
void refuse_values_of_switches(const CLI::App& app, const OptionsGroup& options,
                               const std::vector<std::string>& arguments) {
  for (const auto& description : describe_options(options)) {
    if (description.type != "true|false") continue;
    const auto* option = app.get_option_no_throw("--" + dashed_name(description.key));
    for (const auto& argument : arguments) {
      const size_t equals = argument.find('=');
      if (option == nullptr || equals == std::string::npos || argument.rfind("--", 0) != 0) continue;
      if (!option->check_name(argument.substr(0, equals))) continue;
      const std::string value = argument.substr(equals + 1);
      if (value == "true" || value == "false") continue;
      const std::string flag = argument.substr(0, equals);
      fail({flag, "true or false", "'" + value + "'", "write " + flag + " alone, or leave it out"});
    }
  }
}

// A command whose options are read and checked.
struct Invocation {
  const Command* command = nullptr;
  std::vector<std::string> arguments;
  bool quiet = false;
};

// Keeps standard output from showing anything for as long as it lives.
class SilentOutput {
 public:
  SilentOutput() : before_(std::cout.rdbuf(nullptr)) {}
  ~SilentOutput() {
    std::cout.rdbuf(before_);
    std::cout.clear();  // writing without a buffer sets badbit
  }
  SilentOutput(const SilentOutput&) = delete;
  SilentOutput& operator=(const SilentOutput&) = delete;

 private:
  std::streambuf* before_;
};

int run_invocation(const Invocation& invocation) {
  std::unique_ptr<SilentOutput> silent;
  if (invocation.quiet) silent = std::make_unique<SilentOutput>();
  show_progress(!invocation.quiet);
  return invocation.command->run(invocation.arguments);
}

// The result is empty after --help, which is printed.
std::optional<Invocation> parse(const Command& command, std::vector<std::string> arguments,
                                const OutermostTypes& outermost) {
  CLI::App app;
  app.set_help_all_flag("--help-all");
  app.allow_extras();
  Collected collected;
  if (command.options) add_flags(app, command, outermost, collected);
  try {
    arguments = with_lists_joined(app, command, arguments);
    if (command.options) refuse_values_of_switches(app, *command.options, arguments);
    std::reverse(arguments.begin(), arguments.end());  // CLI11 takes them last first
    app.parse(arguments);
  } catch (const CLI::CallForHelp&) {
    std::cout << short_help(command, outermost);
    return std::nullopt;
  } catch (const CLI::CallForAllHelp&) {
    std::cout << full_help(command, outermost);
    return std::nullopt;
  } catch (const CLI::ArgumentMismatch& error) {  // "--out: 1 required text missing"
    const std::string text = error.what();
    fail({"gld " + command.name, "a value behind " + text.substr(0, text.find(':')), "none",
          "see gld " + command.name + " --help"});
  } catch (const CLI::ParseError& error) {
    fail({"gld " + command.name, "", error.what(), "see gld " + command.name + " --help"});
  }
  const std::vector<std::string> left_over = app.remaining();
  refuse_unknown(command, app, left_over);
  require_argument_count(command, left_over);
  refuse_repeated(command, app, collected);
  if (command.options) {
    apply(collected, command);
    const auto named = named_options(collected);
    if (command.on_named) command.on_named(keys_of(named));
    check_options(*command.options, "gld " + command.name);
    refuse_without_effect(command, named);
  }
  return Invocation{&command, left_over, collected.quiet};
}

// A program, or a command that has commands of its own.
struct CommandGroup {
  std::string program;  // "gld train"
  std::string description;
  const std::vector<Command>& commands;  // outlive what is found among them
  const std::vector<Command>& whole;     // of the whole program
  const OutermostTypes& outermost;       // of the whole program
};

void print_overview(const CommandGroup& group) {
  const std::string& program = group.program;
  if (!group.description.empty()) std::cout << group.description << "\n";
  std::cout << "Usage: " << program << " COMMAND [options]\n\nCommands:\n";
  size_t width = 0;
  for (const auto& command : group.commands) width = std::max(width, last_word(command).size());
  for (const auto& command : group.commands) {
    const std::string last = last_word(command);
    std::cout << "  " << last << std::string(width - last.size() + 2, ' ') << command.summary << "\n";
  }
  std::cout
      << "\n"
      << program
      << " COMMAND --help, or gld help COMMAND, shows a command's usual options, --help-all every "
         "one with type, range\nand default; gld help --man is the manual, and gld --version says which "
         "program this is.\n";
}

// Returns the command of another group whose last word that is, "train level" for "level"; it is empty where there is
// none.
std::string named_so(const std::vector<Command>& commands, const std::string& word) {
  for (const auto& command : commands) {
    if (last_word(command) == word) return command.name;
    if (auto inner = named_so(command.subcommands, word); !inner.empty()) return inner;
  }
  return "";
}

std::optional<Invocation> find_and_parse(const CommandGroup& group,
                                         const std::vector<std::string>& arguments) {
  const auto& [program, description, commands, whole, outermost] = group;
  if (arguments.empty()) {
    print_overview(group);
    fail({program, "a command", "none", "choose one of the above"});
  }
  if (program == "gld" && arguments == std::vector<std::string>{"help", "--man"}) {
    std::cout << manual_page(commands, outermost);
    return std::nullopt;
  }
  if (arguments[0] == "help" && arguments.size() > 1) {  // gld help train level: gld train level --help
    std::vector<std::string> asked(arguments.begin() + 1, arguments.end());
    asked.emplace_back("--help");
    return find_and_parse(group, asked);
  }
  if (arguments[0] == "--help" || arguments[0] == "-h" || arguments[0] == "--help-all" ||
      arguments[0] == "help") {
    print_overview(group);
    return std::nullopt;
  }
  if (arguments[0] == "--version" && program == "gld") {
    std::cout << version_text() << "\n";
    return std::nullopt;
  }
  std::vector<std::string> names;
  for (const auto& command : commands) {
    const std::string last = last_word(command);
    names.push_back(last);
    if (last != arguments[0]) continue;
    const std::vector<std::string> rest(arguments.begin() + 1, arguments.end());
    if (!command.subcommands.empty()) {
      const std::string heading =
          command.summary + (command.description.empty() ? "" : "\n\n" + command.description) + "\n";
      return find_and_parse({"gld " + command.name, heading, command.subcommands, whole, outermost}, rest);
    }
    return parse(command, rest, outermost);
  }
  const auto near = meant_name(arguments[0], names);
  const auto elsewhere = named_so(whole, arguments[0]);
  fail({program, "a command", "'" + arguments[0] + "'",
        !elsewhere.empty() ? "did you mean gld " + elsewhere + "?"
        : near.empty()     ? "see " + program + " --help"
                           : "did you mean '" + near + "'?"});
}

}  // namespace

int run_command_line(const std::vector<Command>& commands, const std::vector<std::string>& arguments) {
  int status_of_error = kWrongUsage;
  install_interrupt_handler(StopDeadline::kOneSecond);
  try {
    const OutermostTypes outermost = outermost_types(commands);
    const auto invocation = find_and_parse({"gld", "", commands, commands, outermost}, arguments);
    if (invocation) status_of_error = kFailed;
    const int status = invocation ? run_invocation(*invocation) : 0;
    status_of_error = kFailed;
    // What a full disk or a closed pipe did not take must not look like success.
    if (!std::cout.flush()) {
      fail({"standard output", "to take the result", "a write that failed",
            "check the disk or the program behind the pipe"});
    }
    return status;
  } catch (const Interrupted& interrupted) {
    std::cerr << "interrupted: " << interrupted.what() << "\n";
    return kInterruptedStatus;
  } catch (const Error& error) {
    std::cerr << "error: " << error.what() << "\n";
    // Some values can only be judged with the scene or the model in hand.
    if (error.parts().where.rfind("--", 0) == 0) return kWrongUsage;
  } catch (const c10::Error& error) {
    const std::string text = error.what_without_backtrace();
    std::cerr << "error: LibTorch refused an operation: " << text.substr(0, text.find('\n')) << "\n";
  } catch (const std::bad_alloc&) {
    std::cerr
        << "error: memory ran out; use fewer views or a smaller size, or see what 'gld doctor' forecasts.\n";
  } catch (const std::filesystem::filesystem_error& error) {
    const Error sentence({printable_text(error.path1().string()), "a file or folder that can be used",
                          error.code().message(), "check the path and its permissions"});
    std::cerr << "error: " << sentence.what() << "\n";
  } catch (const std::exception& error) {
    const std::string text = error.what();
    std::cerr << "error: " << text.substr(0, text.find('\n')) << "\n";
  }
  return status_of_error;
}

}  // namespace gld
