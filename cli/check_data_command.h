#pragma once

#include "cli/command.h"

namespace gld {

Command make_check_data_command();

}  // namespace gld
