#pragma once

#include "gld/base/options.h"

#include <string>

namespace gld {

// Applies what a flag of the command line gives (in configuration.cpp, beside --config and --set, which are YAML):
// value is the text itself. Lists are divided at commas. Errors name the flag alone.
void apply_flag(OptionsGroup& options, const std::string& key, const std::string& value,
                const std::string& flag);

}  // namespace gld
