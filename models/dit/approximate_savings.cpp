#include "models/dit/approximate_savings.h"

#include "gld/base/error.h"

namespace gld {

const std::vector<std::string>& view_pairs_names() {
  static const std::vector<std::string> names{"all", "visible"};
  return names;
}

void ApproximateSavings::visit(FieldVisitor& visitor) {
  visitor.integer(
      {"cascade_encoder_nodes",
       "evaluate the cascade's condition encoder at this many flow times and interpolate; 0: at all"},
      cascade_encoder_nodes, {0, 64});
  visitor.integer(
      {"level1_encoder_every",
       "run M1's condition encoder at every so many evaluations and extrapolate between; 1: at each"},
      level1_encoder_every, {1, 64});
  visit_choice(visitor,
               {"view_pairs", "which views attend to each other: all, or those that can see common space"},
               view_pairs, view_pairs_names());
}

void ApproximateSavings::check() const {
  if (cascade_encoder_nodes == 1) {
    fail({"cascade_encoder_nodes", "at least 2 flow times to interpolate between, or 0 for all", "1",
          "write for example 6"});
  }
}

bool ApproximateSavings::any() const {
  return cascade_encoder_nodes > 0 || level1_encoder_every > 1 || view_pairs != ViewPairs::kAll;
}

}  // namespace gld
