#pragma once

#include "cli/command.h"

namespace gld {

Command make_sample_command();

}  // namespace gld
