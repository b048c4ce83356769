#pragma once

#include "cli/command.h"

#include <map>
#include <set>
#include <string>
#include <vector>

namespace gld {

// A flag of a command, from the registry of options: what the parser takes, help, completion and the manual show.
struct Flag {
  std::string key;  // "solver.evaluations"
  std::string
      shown;  // "--evaluations", the one spelling that is shown; "--solver.tolerance" where a short one is none
  std::string full;  // "--solver.evaluations", which is always taken
  std::string help;
  std::string type;  // as of OptionDescription
  std::string range;
  std::string default_value;
  std::vector<std::string> values;  // of a choice, else empty

  bool is_switch() const { return type == "true|false"; }
  bool has_short_form() const { return shown != full; }
};

// Flags of one group of options, in the order of visit().
struct FlagGroup {
  std::string key;   // "photograph_use.stereo"; empty for those outside groups
  std::string help;  // what the group is; may be empty
  std::vector<Flag> flags;
};

// Types of the options that commands have outside groups, by name: a short spelling means the same in every command.
using OutermostTypes = std::map<std::string, std::set<std::string>>;
OutermostTypes outermost_types(const std::vector<Command>& commands);

// Returns those of the command's options; there are none without any. --help, --help-all, --config, --set and --quiet
// are not among them.
std::vector<Flag> list_flags(const Command& command, const OutermostTypes& outermost);
// Returns those that help, completion and the manual offer: all but what nothing ever looks at (option_uses.h). It is
// taken, as a key of a file that another command wrote, and refused where a command line names it.
std::vector<Flag> offered_flags(const Command& command, const OutermostTypes& outermost);
// Returns the same by group, those outside groups first.
std::vector<FlagGroup> group_flags(const Command& command, const OutermostTypes& outermost);

// A flag that every command with options has beside those.
struct CommonFlag {
  std::string name;   // "--config"
  std::string value;  // "FILE"; empty for a switch
  std::string help;
};
const std::vector<CommonFlag>& common_flags();

// Returns commands that have subcommands and those that run, in the order in which help lists them.
std::vector<const Command*> all_levels(const std::vector<Command>& commands);

// Returns the last word of its name: "level" of "train level".
std::string last_word(const Command& command);

}  // namespace gld
