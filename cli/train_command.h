#pragma once

#include "cli/command.h"

namespace gld {

// gld train backbone|decoder|depth|blending|level|cascade.
Command make_train_command();

}  // namespace gld
