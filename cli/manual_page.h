#pragma once

#include "cli/flag_list.h"

#include <string>
#include <vector>

namespace gld {

// Returns the manual page gld(1) in troff's language with the macros man(7): every command and, by group, every option
// of it. It has the same bytes for the same program.
std::string manual_page(const std::vector<Command>& commands, const OutermostTypes& outermost);

// Returns text that troff shows as it is: '-' stays a hyphen that can be searched and copied, and no line begins a
// request.
std::string troff_text(const std::string& text);

}  // namespace gld
