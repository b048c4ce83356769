#pragma once

#include "ablate/plan/program_commands.h"
#include "cli/command.h"

namespace gld {

// Returns the commands of this program that can be a stage: those that write into a folder.
ProgramCommands this_program();

Command make_ablate_command();

}  // namespace gld
