#pragma once

#include "models/decoders/geometry_head.h"
#include "models/layers/chosen_architecture.h"

#include <memory>
#include <vector>

namespace gld {

using GeometryHeadKind = ArchitectureKind<GeometryHeadArchitecture>;

// Returns all families, the default one first, and "none" for backbones without geometry.
const std::vector<GeometryHeadKind>& geometry_head_kinds();

// The geometry head of a bundle (dpt_head in model.yaml): its kind, and that kind's fields.
class GeometryHeadOptions : public ChosenArchitecture<GeometryHeadArchitecture> {
 public:
  GeometryHeadOptions();                                              // the first of geometry_head_kinds()
  GeometryHeadOptions(const GeometryHeadArchitecture& architecture);  // NOLINT: an architecture is a choice

  static GeometryHeadOptions none();
  bool exists() const;
  bool predicts_rays() const { return exists() && architecture().predicts_rays(); }
  std::shared_ptr<GeometryHead> make(const ParameterPlacement& placement) const {
    return architecture().make(placement);
  }
  Cost cost(const LatentGrid& grid, GeometryMaps maps) const { return architecture().cost(grid, maps); }
};

}  // namespace gld
