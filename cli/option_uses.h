#pragma once

#include "cli/command.h"

#include <string>
#include <vector>

namespace gld {

// An option that the command line names, by its key, and as it is written there.
struct NamedOption {
  std::string key;   // "solver.tolerance"
  std::string flag;  // "--solver.tolerance", "--set solver.tolerance"
};

// When something looks at an option of a command: as long as another option of the command has, or has not, one of some
// values. Both are the ends of their keys; a key that ends with '.' is a group with all of it. The other option is that
// of the same group, or else one of any group.
struct OptionUse {
  std::string command;  // it begins so; empty: any
  std::string key;
  std::string needs;  // empty: nothing ever looks at it
  enum class Condition { kOneOf, kNoneOf } condition = Condition::kOneOf;
  std::vector<std::string> values;  // as --help shows defaults
  std::string what;                 // is asked for: "--algorithm muon"
};

// Returns what holds for commands of the program beside what their options check themselves.
const std::vector<OptionUse>& option_uses();

// Throws Error for a named option that nothing would look at: what was asked for would silently not happen.
void refuse_without_effect(const Command& command, const std::vector<NamedOption>& named);

// For tests: whether the command has the option of the rule.
bool applies_to(const OptionUse& use, const Command& command, const std::string& key);

}  // namespace gld
