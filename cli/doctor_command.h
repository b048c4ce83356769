#pragma once

#include "cli/command.h"

namespace gld {

Command make_doctor_command();

}  // namespace gld
