#include "models/dit/approximate_savings.h"

#include "gld/base/error.h"

namespace gld {

void ApproximateSavings::visit(FieldVisitor& visitor) {
  visitor.integer(
      {"cascade_encoder_nodes",
       "evaluate the cascade's condition encoder at this many flow times and interpolate; 0: at all"},
      cascade_encoder_nodes, {0, 64});
}

void ApproximateSavings::check() const {
  if (cascade_encoder_nodes == 1) {
    fail({"cascade_encoder_nodes", "at least 2 flow times to interpolate between, or 0 for all", "1",
          "write for example 6"});
  }
}

bool ApproximateSavings::any() const { return cascade_encoder_nodes > 0; }

}  // namespace gld
