#pragma once

#include "cli/command.h"

namespace gld {

// gld bench solvers|stiff|extremes: error against run time, and numerical stability.
Command make_bench_command();

}  // namespace gld
