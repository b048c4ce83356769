#pragma once

#include "cli/command.h"

namespace gld {

Command make_report_command();

}  // namespace gld
