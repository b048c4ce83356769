#include "gld/kernels/matrix_unit_kernels.h"

#include "gld/base/error.h"
#include "gld/kernels/matrix_unit_variants.h"

#include <algorithm>

namespace gld {

const MatrixUnitKernels& matrix_unit_kernels(MatrixUnit unit, ComputePrecision precision) {
  const auto available = available_matrix_units(precision);
  if (precision == ComputePrecision::kFloat32 ||
      std::find(available.begin(), available.end(), unit) == available.end()) {
    fail({"matrix unit", "one that this processor and build have for " + compute_precision_name(precision),
          matrix_unit_name(unit), "use " + matrix_unit_name(available.back())});
  }
#ifdef GLD_X86_KERNELS
  if (unit == MatrixUnit::kAmx) return amx_unit_kernels();
  if (unit == MatrixUnit::kAvx512) return avx512_unit_kernels();
#endif
  return plain_unit_kernels();
}

}  // namespace gld
