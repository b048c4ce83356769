#pragma once

#include "gld/machine/matrix_unit.h"

#include <string>
#include <vector>

namespace gld {

// Returns float32, then the named ones that are not yet there. Throws Error, naming --precisions, for a name that is no
// precision.
std::vector<ComputePrecision> benchmark_precisions(const std::vector<std::string>& names);

}  // namespace gld
