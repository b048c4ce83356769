#pragma once

#include "cli/command.h"

namespace gld {

Command make_plan_command();

}  // namespace gld
