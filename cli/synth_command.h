#pragma once

#include "cli/command.h"

namespace gld {

Command make_synth_command();

}  // namespace gld
