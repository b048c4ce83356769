#pragma once

#include "cli/command.h"

namespace gld {

// gld bench solvers|stiff|extremes|sample and others measure error against run time, numerical stability, speed.
Command make_bench_command();

}  // namespace gld
