#pragma once

#include "cli/command.h"

#include <string>
#include <vector>

namespace gld {

// gld completion bash|zsh|fish. commands gives those that are completed, when it runs.
Command make_completion_command(std::vector<Command> (*commands)());

}  // namespace gld
