#pragma once

#include "gld/kernels/matrix_unit_kernels.h"

namespace gld {

const MatrixUnitKernels& plain_unit_kernels();
#ifdef GLD_X86_KERNELS
const MatrixUnitKernels& avx512_unit_kernels();
const MatrixUnitKernels& amx_unit_kernels();
#endif

}  // namespace gld
