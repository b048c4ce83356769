#pragma once

#include "cli/command.h"

namespace gld {

Command make_eval_command();

}  // namespace gld
