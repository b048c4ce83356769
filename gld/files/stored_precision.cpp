#include "gld/files/stored_precision.h"

namespace gld {

DType stored_dtype(StoredPrecision precision) {
  switch (precision) {
    case StoredPrecision::kFloat16:
      return DType::kFloat16;
    case StoredPrecision::kBFloat16:
      return DType::kBFloat16;
    case StoredPrecision::kFloat32:
      break;
  }
  return DType::kFloat32;
}

void visit_store(FieldVisitor& visitor, StoredPrecision& store) {
  visit_choice(visitor, {"store", "how floating-point weights are stored"}, store,
               {"float32", "float16", "bfloat16"});
}

}  // namespace gld
