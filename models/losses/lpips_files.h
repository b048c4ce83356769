#pragma once

#include "gld/base/options.h"
#include "models/losses/lpips.h"

#include <memory>
#include <string>

namespace gld {

// Where a measurement or a training finds the weights of LPIPS, which are not part of this project.
struct LpipsFiles : OptionsGroup {
  std::string lpips_backbone;  // torchvision's network; empty: no LPIPS
  std::string lpips_heads;     // published linear heads
  LpipsOptions lpips;

  void visit(FieldVisitor& visitor) override;
  void check() const override;  // both files or neither
};

// Returns null without weights.
std::shared_ptr<Lpips> load_lpips(const LpipsFiles& files, const ParameterPlacement& placement = {});

}  // namespace gld
