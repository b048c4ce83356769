#pragma once

#include "cli/command.h"

namespace gld {

Command make_export_command();

}  // namespace gld
