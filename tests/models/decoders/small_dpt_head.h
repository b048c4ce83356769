#pragma once

#include "models/decoders/dpt_head.h"

#include <memory>

#include <ATen/CPUGeneratorImpl.h>

namespace gld::test {

inline DptHeadOptions small_dpt_head() {
  DptHeadOptions options;
  options.dim_in = 24;
  options.features = 16;
  options.out_channels = {8, 12, 16, 20};
  return options;
}

inline std::shared_ptr<DptHead> random_head(const DptHeadOptions& options) {
  auto head = std::make_shared<DptHead>(options, ParameterPlacement());
  head->initialise(at::detail::createCPUGenerator(3));
  return head;
}

}  // namespace gld::test
