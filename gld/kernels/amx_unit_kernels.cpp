#include "gld/kernels/amx_tiles.h"
#include "gld/kernels/matrix_unit_loops.h"
#include "gld/kernels/matrix_unit_variants.h"

namespace gld {

const MatrixUnitKernels& amx_unit_kernels() {
  static const MatrixUnitKernels kernels = kernels_of<TileUnit<AmxTiles>>(MatrixUnit::kAmx);
  return kernels;
}

}  // namespace gld
