#pragma once

#include "cli/command.h"

#include <vector>

namespace gld {

// Returns every command, in the order gld --help shows them.
std::vector<Command> all_commands();

}  // namespace gld
