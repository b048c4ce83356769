#pragma once

#include "gld/base/options.h"
#include "gld/files/dtype.h"

namespace gld {

// How floating-point weights are stored, which is another matter than what is computed in (--precision).
enum class StoredPrecision { kFloat32, kFloat16, kBFloat16 };

DType stored_dtype(StoredPrecision precision);

// --store of every command that writes a model.
void visit_store(FieldVisitor& visitor, StoredPrecision& store);

}  // namespace gld
