#pragma once

#include <string>

namespace gld {

// "AMD EPYC 9B14 96-Core Processor"; "unknown" where the system does not say.
std::string processor_name();

}  // namespace gld
