#pragma once

#include "cli/flag_list.h"

#include <string>

namespace gld {

// gld COMMAND --help is at most so many lines.
constexpr size_t kMostLinesOfHelp = 25;

// Returns what gld COMMAND --help shows: the options that Command::usual names under their headings, where it names
// none those outside groups, and what every run has, and how many more there are. It has one line an option, whose help
// is cut at a clause.
std::string short_help(const Command& command, const OutermostTypes& outermost);

// Returns what gld COMMAND --help-all shows: every option once, by group, with type, range and default. The heading of
// a group is the beginning of its keys: below "--solver.*", --evaluations is taken as --solver.evaluations too.
std::string full_help(const Command& command, const OutermostTypes& outermost);

// Returns "integer [1, 100]=4", which is shown behind a flag; it is empty for a switch.
std::string type_of_value(const Flag& flag);
// Returns "--[no-]ema" for a switch that is on by default, else the name alone.
std::string shown_name(const Flag& flag);
// Returns the flag's help up to a clause that leaves it within a number of characters.
std::string first_clause(const std::string& help, size_t most);
// Returns for example "gld check-data SCENE... [options]".
std::string usage_line(const Command& command);

}  // namespace gld
