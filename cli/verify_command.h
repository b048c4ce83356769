#pragma once

#include "cli/command.h"

namespace gld {

// gld verify DIR...
Command make_verify_command();

}  // namespace gld
