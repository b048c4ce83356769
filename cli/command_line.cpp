#include "cli/command.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"

#include <algorithm>
#include <iostream>
#include <map>
#include <new>
#include <optional>

#include <c10/util/Exception.h>

#include <CLI/CLI.hpp>

namespace gld {
namespace {

constexpr int kFailed = 1;
constexpr int kWrongUsage = 2;
constexpr int kInterrupted = 130;  // the shell's convention for SIGINT

struct Setting {
  std::string key;
  std::string value;
};

// What the command line said about the options, before it is applied in the documented order.
struct Collected {
  std::string config_file;
  std::vector<std::string> settings;
  std::vector<Setting> flags;
};

std::string dashed(std::string key) {
  std::replace(key.begin(), key.end(), '_', '-');
  return key;
}

std::string last_part(const std::string& key) { return key.substr(key.rfind('.') + 1); }

// "--solver.evaluations,--evaluations": the short form only where it is unambiguous.
std::string flag_names(const std::string& key, const std::map<std::string, int>& uses_of_last_part,
                       const std::string& prefix) {
  std::string names = prefix + dashed(key);
  const std::string last = last_part(key);
  if (last != key && uses_of_last_part.at(last) == 1) names += "," + prefix + dashed(last);
  return names;
}

void add_flags(CLI::App& app, const OptionsGroup& options, Collected& collected) {
  app.add_option("--config", collected.config_file, "YAML file of options, applied before --set and flags")
      ->type_name("FILE");
  app.add_option("--set", collected.settings, "set one option, applied after --config; may be repeated")
      ->type_name("KEY=VALUE")
      ->allow_extra_args(false);
  const auto descriptions = describe_options(options);
  std::map<std::string, int> uses_of_last_part{{"config", 1}, {"set", 1}, {"help", 1}};
  for (const auto& description : descriptions) ++uses_of_last_part[last_part(description.key)];
  for (const auto& description : descriptions) {
    const std::string key = description.key;
    std::string type = description.type;
    if (!description.range.empty()) type += " " + description.range;
    if (description.type == "true|false") {
      const std::string names =
          flag_names(key, uses_of_last_part, "--") + "," + flag_names(key, uses_of_last_part, "!--no-");
      app.add_flag_function(
             names,
             [&collected, key](int64_t count) {
               collected.flags.push_back({key, count > 0 ? "true" : "false"});
             },
             description.help + " (default " + description.default_value + ")")
          ->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
      continue;
    }
    auto* option = app.add_option_function<std::string>(
        flag_names(key, uses_of_last_part, "--"),
        [&collected, key](const std::string& value) {
          collected.flags.push_back({key, value});
        },
        description.help);
    option->type_name(type)->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
    if (!description.default_value.empty()) option->default_str(description.default_value);
  }
}

std::vector<std::string> known_flags(const CLI::App& app) {
  std::vector<std::string> names;
  for (const auto* option : app.get_options()) {
    for (const auto& name : option->get_lnames()) names.push_back("--" + name);
  }
  return names;
}

void refuse_unknown(const Command& command, const CLI::App& app, const std::vector<std::string>& left_over) {
  for (const auto& argument : left_over) {
    if (argument.size() < 2 || argument[0] != '-') continue;
    const std::string flag = argument.substr(0, argument.find('='));
    const auto near = nearest_name(flag, known_flags(app));
    fail({"gld " + command.name, "a known flag", "'" + flag + "'",
          near.empty() ? "see gld " + command.name + " --help" : "did you mean " + near + "?"});
  }
}

void require_argument_count(const Command& command, size_t count) {
  const Arguments& arguments = command.arguments;
  if (count >= arguments.minimum && count <= arguments.maximum) return;
  const std::string expected =
      arguments.maximum == 0 ? "no argument without a flag"
      : arguments.minimum == arguments.maximum
          ? std::to_string(arguments.minimum) + " argument(s): " + arguments.usage
          : "at least " + std::to_string(arguments.minimum) + " argument(s): " + arguments.usage;
  fail({"gld " + command.name, expected, std::to_string(count), "see gld " + command.name + " --help"});
}

void apply(const Collected& collected, OptionsGroup& options) {
  if (!collected.config_file.empty()) load_yaml(options, collected.config_file);
  for (const auto& setting : collected.settings) apply_setting(options, setting);
  for (const auto& flag : collected.flags) {
    apply_setting(options, flag.key, flag.value, "--" + dashed(flag.key));
  }
}

std::vector<std::string> named_keys(const Collected& collected) {
  std::vector<std::string> keys;
  for (const auto& setting : collected.settings) keys.push_back(setting.substr(0, setting.find('=')));
  for (const auto& flag : collected.flags) keys.push_back(flag.key);
  return keys;
}

// A command whose options are read and checked.
struct Invocation {
  const Command* command = nullptr;
  std::vector<std::string> arguments;
};

// Empty after --help, which is printed.
std::optional<Invocation> parse(const Command& command, std::vector<std::string> arguments) {
  CLI::App app(
      command.summary + (command.description.empty() ? "" : "\n\n" + command.description),
      "gld " + command.name + (command.arguments.usage.empty() ? "" : " " + command.arguments.usage));
  app.allow_extras();
  app.get_formatter()->column_width(48);
  Collected collected;
  if (command.options) add_flags(app, *command.options, collected);
  try {
    std::reverse(arguments.begin(), arguments.end());  // CLI11 takes them last first
    app.parse(arguments);
  } catch (const CLI::CallForHelp&) {
    std::cout << app.help();
    return std::nullopt;
  } catch (const CLI::ParseError& error) {
    fail({"gld " + command.name, "", error.what(), "see gld " + command.name + " --help"});
  }
  const std::vector<std::string> left_over = app.remaining();
  refuse_unknown(command, app, left_over);
  require_argument_count(command, left_over.size());
  if (command.options) {
    apply(collected, *command.options);
    if (command.on_named) command.on_named(named_keys(collected));
    check_options(*command.options, "gld " + command.name);
  }
  return Invocation{&command, left_over};
}

// A program, or a command that has commands of its own.
struct CommandGroup {
  std::string program;  // "gld train"
  std::string description;
  const std::vector<Command>& commands;  // outlive what is found among them
};

void print_overview(const CommandGroup& group) {
  const auto& [program, description, commands] = group;
  if (!description.empty()) std::cout << description << "\n";
  std::cout << "Usage: " << program << " COMMAND [options]\n\nCommands:\n";
  const auto last_word = [](const Command& command) {
    return command.name.substr(command.name.rfind(' ') + 1);
  };
  size_t width = 0;
  for (const auto& command : commands) width = std::max(width, last_word(command).size());
  for (const auto& command : commands) {
    const std::string last = last_word(command);
    std::cout << "  " << last << std::string(width - last.size() + 2, ' ') << command.summary << "\n";
  }
  std::cout << "\n" << program << " COMMAND --help lists a command's options with type, range and default.\n";
}

std::optional<Invocation> find_and_parse(const CommandGroup& group,
                                         const std::vector<std::string>& arguments) {
  const auto& [program, description, commands] = group;
  if (arguments.empty()) {
    print_overview(group);
    fail({program, "a command", "none", "choose one of the above"});
  }
  if (arguments[0] == "--help" || arguments[0] == "-h" || arguments[0] == "help") {
    print_overview(group);
    return std::nullopt;
  }
  std::vector<std::string> names;
  for (const auto& command : commands) {
    const std::string last = command.name.substr(command.name.rfind(' ') + 1);
    names.push_back(last);
    if (last != arguments[0]) continue;
    const std::vector<std::string> rest(arguments.begin() + 1, arguments.end());
    if (!command.subcommands.empty()) {
      const std::string heading =
          command.summary + (command.description.empty() ? "" : "\n\n" + command.description) + "\n";
      return find_and_parse({"gld " + command.name, heading, command.subcommands}, rest);
    }
    return parse(command, rest);
  }
  const auto near = nearest_name(arguments[0], names);
  fail({program, "a command", "'" + arguments[0] + "'",
        near.empty() ? "see " + program + " --help" : "did you mean '" + near + "'?"});
}

}  // namespace

int run_command_line(const std::vector<Command>& commands, const std::vector<std::string>& arguments) {
  int status_of_error = kWrongUsage;
  try {
    const auto invocation = find_and_parse({"gld", "", commands}, arguments);
    if (!invocation) return 0;
    status_of_error = kFailed;
    const int status = invocation->command->run(invocation->arguments);
    // What a full disk or a closed pipe did not take must not look like success.
    if (!std::cout.flush()) {
      fail({"standard output", "to take the result", "a write that failed",
            "check the disk or the program behind the pipe"});
    }
    return status;
  } catch (const Interrupted& interrupted) {
    std::cerr << "interrupted: " << interrupted.what() << "\n";
    return kInterrupted;
  } catch (const Error& error) {
    std::cerr << "error: " << error.what() << "\n";
  } catch (const c10::Error& error) {
    const std::string text = error.what_without_backtrace();
    std::cerr << "error: LibTorch refused an operation: " << text.substr(0, text.find('\n')) << "\n";
  } catch (const std::bad_alloc&) {
    std::cerr
        << "error: memory ran out; use fewer views or a smaller size, or see what 'gld doctor' forecasts.\n";
  } catch (const std::exception& error) {
    const std::string text = error.what();
    std::cerr << "error: " << text.substr(0, text.find('\n')) << "\n";
  }
  return status_of_error;
}

}  // namespace gld
