#pragma once

#include "cli/command.h"

namespace gld {

Command make_convert_command();

}  // namespace gld
