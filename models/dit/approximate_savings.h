#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Which pairs of views attend to each other in a DiT^DH.
enum class ViewPairs {
  kAll,
  kVisible,  // only those that can see common space; the others' attention blocks are left out
};

const std::vector<std::string>& view_pairs_names();

// Work of the diffusion models that can be left out with an error (NUMBERS.md, "What can be left out approximately").
// All off by default; `gld bench sample-plan` measures the error of each.
struct ApproximateSavings : OptionsGroup {
  // The cascade's condition encoder is a function of the flow time alone: evaluate it at this many times and
  // interpolate (models/dit/node_field.h). 0: at every evaluation's own time.
  int64_t cascade_encoder_nodes = 0;
  // Run the condition encoder of M1 at every so many evaluations and extrapolate in between
  // (models/dit/extrapolated_field.h). 1: at each.
  int64_t level1_encoder_every = 1;
  ViewPairs view_pairs = ViewPairs::kAll;

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  bool any() const;
};

}  // namespace gld
