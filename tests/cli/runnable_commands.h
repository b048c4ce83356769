#pragma once

#include "cli/commands.h"

#include <vector>

namespace gld::test {

inline void add_runnable(const std::vector<Command>& commands, std::vector<Command>& runnable) {
  for (const auto& command : commands) {
    if (command.subcommands.empty()) runnable.push_back(command);
    add_runnable(command.subcommands, runnable);
  }
}

// Returns all commands of the program that have no subcommands.
inline std::vector<Command> runnable_commands() {
  std::vector<Command> runnable;
  add_runnable(all_commands(), runnable);
  return runnable;
}

}  // namespace gld::test
