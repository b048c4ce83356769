#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <vector>

namespace gld {

// Of PhotographBlending (photograph_blending.h). Ours; no published model has it.
struct BlendingOptions : OptionsGroup {
  std::vector<int64_t>
      channels;  // of the network at full size, half, a quarter ...; none: the model has no blending
  int64_t side =
      112;  // pixels: larger pictures are looked at reduced to it, as those were that it was trained on

  void visit(FieldVisitor& visitor) override;
  void check() const override;
  bool exists() const { return !channels.empty(); }
};

}  // namespace gld
