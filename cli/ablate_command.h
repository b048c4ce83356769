#pragma once

#include "cli/command.h"

namespace gld {

Command make_ablate_command();

}  // namespace gld
