#include "gld/kernels/dot_unit.h"
#include "gld/kernels/matrix_unit_loops.h"
#include "gld/kernels/matrix_unit_variants.h"

namespace gld {

const MatrixUnitKernels& avx512_unit_kernels() {
  static const MatrixUnitKernels kernels = kernels_of<DotUnit>(MatrixUnit::kAvx512);
  return kernels;
}

}  // namespace gld
