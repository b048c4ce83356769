#pragma once

#include "models/backbones/backbone.h"
#include "models/layers/chosen_architecture.h"

#include <memory>
#include <vector>

namespace gld {

using BackboneKind = ArchitectureKind<BackboneArchitecture>;

// Returns all families, the default one first. A new one is a file of its own and one line in backbone_registry.cpp.
const std::vector<BackboneKind>& backbone_kinds();

// The backbone of a bundle: its kind, and that kind's fields.
class BackboneOptions : public ChosenArchitecture<BackboneArchitecture> {
 public:
  BackboneOptions();  // the first of backbone_kinds()
  BackboneOptions(
      const BackboneArchitecture& architecture);  // NOLINT: an architecture is a choice of backbone

  std::shared_ptr<Backbone> make(const ParameterPlacement& placement) const {
    return architecture().make(placement);
  }
  int64_t patch_side() const { return architecture().patch_side(); }
  int64_t levels() const { return architecture().levels(); }
  int64_t level_channels() const { return architecture().level_channels(); }
  int64_t leading_tokens() const { return architecture().leading_tokens(); }
  LatentGrid grid_of(int64_t views, int64_t image_height, int64_t image_width) const {
    return architecture().grid_of(views, image_height, image_width);
  }
};

}  // namespace gld
