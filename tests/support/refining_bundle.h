#pragma once

#include "models/bundle/random_bundle.h"

namespace gld::test {

// Returns the small model with a refiner of its own samples.
inline BundleOptions small_refining_bundle_options() {
  BundleOptions model = small_bundle_options();
  model.refiner.degraded = DegradedLatents::kGenerated;
  model.refiner.channels = {32, 32};
  model.refiner.heads = {2, 2};
  model.refiner.latent_channels =
      static_cast<int64_t>(model.generators.size()) * model.backbone.level_channels();
  model.refiner.attention = ViewAttention::kCross;
  return model;
}

}  // namespace gld::test
