#include "models/decoders/geometry_head.h"

namespace gld {

GeometryOutput GeometryHead::look(const GeometryInputs& inputs, const LatentGrid& grid,
                                  GeometryMaps maps) const {
  GeometryOutput said = forward(inputs, grid, maps);
  if (single_view_unit_ && grid.views == 1 && said.depth.defined())
    said.single_view = SingleView{single_view_unit_, look_of_view(inputs.levels.front()[0], said.depth[0])};
  return said;
}

}  // namespace gld
