#pragma once

#include "models/backbones/da3_backbone.h"

#include <cstdint>
#include <memory>

#include <ATen/CPUGeneratorImpl.h>

namespace gld::test {

inline Da3BackboneOptions small_da3() {
  Da3BackboneOptions options;
  options.embed_dim = 48;
  options.num_heads = 3;
  options.pos_embed_grid = 5;
  return options;
}

// The backbone has weights of the scale of a trained model, so that every part matters.
inline std::shared_ptr<Da3Backbone> random_da3(const Da3BackboneOptions& options, uint64_t seed = 1) {
  auto backbone = std::make_shared<Da3Backbone>(options, ParameterPlacement());
  const torch::NoGradGuard no_grad;
  backbone->initialise(at::detail::createCPUGenerator(seed));
  for (auto& parameter : backbone->parameters()) {
    if (parameter.dim() > 1) parameter.mul_(8);
  }
  return backbone;
}

}  // namespace gld::test
