#pragma once

#include "cli/flag_list.h"

#include <string>
#include <vector>

namespace gld {

// Scripts with which shells complete what follows "gld": commands and their subcommands, flags in their one spelling,
// the names that a choice may have, folders and files where a text is asked for. They are made from the registry of
// commands and options and call nothing when they run.
std::string bash_completion(const std::vector<Command>& commands, const OutermostTypes& outermost);
std::string zsh_completion(const std::vector<Command>& commands, const OutermostTypes& outermost);
std::string fish_completion(const std::vector<Command>& commands, const OutermostTypes& outermost);

}  // namespace gld
