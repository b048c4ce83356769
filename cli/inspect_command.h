#pragma once

#include "cli/command.h"

namespace gld {

Command make_inspect_command();

}  // namespace gld
