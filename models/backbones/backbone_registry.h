#pragma once

#include "models/backbones/backbone.h"

#include <memory>
#include <string>
#include <vector>

namespace gld {

// A family of backbones: its name in model.yaml, and its architecture with the defaults of its most common size.
struct BackboneKind {
  std::string name;
  std::unique_ptr<BackboneArchitecture> (*architecture)();
};

// All families, the default one first. A new one is a file of its own and one line in backbone_registry.cpp.
const std::vector<BackboneKind>& backbone_kinds();

// The backbone of a bundle: its kind, and that kind's fields. Copies hold architectures of their own.
class BackboneOptions : public OptionsGroup {
 public:
  BackboneOptions();  // the first of backbone_kinds()
  BackboneOptions(
      const BackboneArchitecture& architecture);  // NOLINT: an architecture is a choice of backbone
  BackboneOptions(const BackboneOptions& other);
  BackboneOptions& operator=(const BackboneOptions& other);
  ~BackboneOptions() override = default;

  // Reads the kind first; the fields are then those of that kind.
  void visit(FieldVisitor& visitor) override;
  void check() const override { architecture_->check(); }

  const BackboneArchitecture& architecture() const { return *architecture_; }
  // For who knows the family. std::bad_cast where it is another.
  template <class Architecture>
  Architecture& as() {
    return dynamic_cast<Architecture&>(*architecture_);
  }
  template <class Architecture>
  const Architecture& as() const {
    return dynamic_cast<const Architecture&>(*architecture_);
  }

  std::shared_ptr<Backbone> make(const ParameterPlacement& placement) const {
    return architecture_->make(placement);
  }
  int64_t patch_side() const { return architecture_->patch_side(); }
  int64_t levels() const { return architecture_->levels(); }
  int64_t level_channels() const { return architecture_->level_channels(); }
  int64_t leading_tokens() const { return architecture_->leading_tokens(); }
  LatentGrid grid_of(int64_t views, int64_t image_height, int64_t image_width) const {
    return architecture_->grid_of(views, image_height, image_width);
  }

 private:
  std::unique_ptr<BackboneArchitecture> architecture_;
};

}  // namespace gld
