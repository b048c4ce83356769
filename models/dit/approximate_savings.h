#pragma once

#include "gld/base/options.h"

#include <cstdint>

namespace gld {

// Work of the diffusion models that can be left out with an error (NUMBERS.md, "What can be left out approximately").
// All off by default; `gld bench sample` measures the error of each.
struct ApproximateSavings : OptionsGroup {
  // The cascade's condition encoder is a function of the flow time alone: evaluate it at this many times and
  // interpolate (models/dit/node_field.h). With 0 it is evaluated at every evaluation's own time.
  int64_t cascade_encoder_nodes = 0;

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  bool any() const;
};

}  // namespace gld
