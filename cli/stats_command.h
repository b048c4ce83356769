#pragma once

#include "cli/command.h"

namespace gld {

Command make_stats_command();

}  // namespace gld
