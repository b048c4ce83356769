#include "gld/kernels/matrix_unit_loops.h"
#include "gld/kernels/matrix_unit_variants.h"
#include "gld/kernels/plain_tiles.h"

namespace gld {

const MatrixUnitKernels& plain_unit_kernels() {
  static const MatrixUnitKernels kernels = kernels_of<TileUnit<PlainTiles>>(MatrixUnit::kPlain);
  return kernels;
}

}  // namespace gld
