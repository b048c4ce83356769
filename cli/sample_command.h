#pragma once

#include "cli/command.h"

namespace gld {

Command make_sample_command();

// Returns what --help shows of the options of gld sample, which gld plan has too.
std::vector<UsualOptions> usual_sampling_options();

}  // namespace gld
