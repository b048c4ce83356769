#include "cli/command.h"
#include "cli/commands.h"

#include <string>
#include <vector>

int main(int argc, char** argv) {
  const std::vector<std::string> arguments(argv + 1, argv + argc);
  return gld::run_command_line(gld::all_commands(), arguments);
}
