#pragma once

#include "gld/base/options.h"

#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace gld {

// One command of the program. Its file parses nothing and computes nothing: it names an options struct and
// the function that does the work.
//
//   Command make_inspect_command() {
//     auto options = std::make_shared<InspectOptions>();
//     Command command;
//     command.name = "inspect";
//     command.summary = "List the tensors of a weight file or model bundle";
//     command.arguments = {"FILE|FOLDER", 1, 1};
//     command.options = options;
//     command.run = [options](const std::vector<std::string>& arguments) {
//       return inspect(arguments[0], *options);
//     };
//     return command;
//   }
struct Arguments {
  std::string usage;   // as --help shows it, empty when the command takes none
  size_t minimum = 0;  // how many positional arguments
  size_t maximum = 0;
};

// These options gld COMMAND --help shows under one heading; all others stand in --help-all alone.
struct UsualOptions {
  std::string heading;
  std::vector<std::string> keys;  // "views.sources"
};

struct Command {
  std::string name;
  std::string summary;  // one line for gld --help
  std::string
      description;  // more for gld COMMAND --help-all, its first line, an example, for --help too; may be empty
  Arguments arguments;
  // Every field becomes a flag: field "guidance.scale" is --guidance.scale, and --scale too where no other field of the
  // command ends like that; underscores are dashes. Booleans are --name and --no-name. All commands have
  // --config FILE.yaml, --set key=value and --quiet as well. A flag's value is its text, YAML is only what stands in
  // the file and right of --set's "=".
  std::shared_ptr<OptionsGroup> options;
  // What --help shows beside --out, --seed and the like, in that order; empty: the first ones outside groups.
  std::vector<UsualOptions> usual;
  // Reads what --config names where that is more than a file of options; where it is empty, that is one.
  std::function<void(const std::string& file)> read_config;
  // Called before options are checked, with the keys ("group.field") that flags and --set name; may be empty.
  std::function<void(const std::vector<std::string>& keys)> on_named;
  // Called after options are read and checked. Returns the exit status.
  std::function<int(const std::vector<std::string>& arguments)> run;
  std::vector<Command> subcommands;  // instead of run
};

// Runs the command that arguments (without the program's name) ask for. Returns the exit status: 0 is done, 1 failed, 2
// wrong usage (an Error about a flag, whenever it is found), 130 interrupted. Messages go to standard error, help to
// standard output.
int run_command_line(const std::vector<Command>& commands, const std::vector<std::string>& arguments);

}  // namespace gld
