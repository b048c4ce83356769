#pragma once

#include "cli/command.h"

namespace gld {

Command make_splat_command();

}  // namespace gld
