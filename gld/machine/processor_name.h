#pragma once

#include <string>

namespace gld {

// Returns "AMD EPYC 9B14 96-Core Processor", for example, and "unknown" where the system does not say.
std::string processor_name();

}  // namespace gld
