#include "cli/commands.h"

#include "cli/verify_command.h"

namespace gld {

std::vector<Command> all_commands() { return {make_verify_command()}; }

}  // namespace gld
