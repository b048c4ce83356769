#include "infer/forecast/stage_memory.h"

#include "models/weights/weight_loading.h"

#include <algorithm>

#include <torch/types.h>

namespace gld {

int64_t predicted_peak_bytes(const StageMemory& memory) {
  // LibTorch's, OpenCV's and BLAS's libraries and heaps take this before any model is loaded, as measured.
  constexpr int64_t kProgramBytes = 215'000'000;
  // Packed panels of products and attention and buffers of BLAS take this, as measured in large stages.
  constexpr int64_t kMostScratchBytes = 60'000'000;
  constexpr double kKeptShare = 0.5;  // of activations, measured
  const int64_t computing = std::min(kMostScratchBytes, memory.working) + memory.weights + memory.working +
                            static_cast<int64_t>(kKeptShare * static_cast<double>(memory.working));
  return kProgramBytes + memory.held + std::max(computing, memory.converted);
}

int64_t weight_bytes_of(const BundlePart& part, const BundleOptions& options) {
  ParameterPlacement meta;
  meta.device = torch::kMeta;
  int64_t bytes = 0;
  for (const auto& [name, tensor] : named_tensors(*make_bundle_module(part, options, meta))) {
    bytes += tensor.numel() * tensor.element_size();
  }
  return bytes;
}

}  // namespace gld
