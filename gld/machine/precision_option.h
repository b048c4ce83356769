#pragma once

#include "gld/base/options.h"
#include "gld/machine/matrix_unit.h"

#include <string>

namespace gld {

// --precision of the commands that run models: the names of ComputePrecision in their order, then automatic.
enum class PrecisionChoice { kFloat32, kBFloat16, kInt8, kAutomatic };

void visit_precision(FieldVisitor& visitor, PrecisionChoice& choice);

// Returns the precision that a choice other than kAutomatic names.
ComputePrecision precision_of(PrecisionChoice choice);

// Throws Error, one sentence, where the device ("cpu", "cuda:0") does not compute in it: int8 is of our kernels for the
// CPU.
void check_precision_on(const std::string& device, ComputePrecision precision);

// Returns "bfloat16 on AVX512-BF16", or of a GPU "bfloat16 on cuda:0"; or "float32".
std::string precision_text(ComputePrecision precision, const std::string& device = "cpu");

}  // namespace gld
