#include "models/layers/layer_precision.h"

#include "gld/machine/block_memory.h"

namespace gld {

LayerPrecision layer_precision(ComputePrecision asked, ModelKind kind) {
  LayerPrecision precision;
  const bool int8 = asked == ComputePrecision::kInt8;
  precision.linear = int8 && kind == ModelKind::kBackboneOrDecoder ? ComputePrecision::kBFloat16 : asked;
  const bool has_unit = best_matrix_unit(ComputePrecision::kBFloat16) != MatrixUnit::kPlain;
  if (asked == ComputePrecision::kBFloat16 || (int8 && has_unit)) {
    precision.attention = ComputePrecision::kBFloat16;
  }
  return precision;
}

void use_precision(torch::nn::Module& model, const LayerPrecision& precision) {
  for (const auto& parameter : model.parameters()) {
    if (!parameter.is_cpu()) return;
  }
  if (auto* layer = dynamic_cast<PrecisionLayer*>(&model)) layer->use_precision(precision);
  // Without itself, which LibTorch only gives where it is held by a shared pointer.
  for (const auto& module : model.modules(/*include_self=*/false)) {
    if (auto* layer = dynamic_cast<PrecisionLayer*>(module.get())) layer->use_precision(precision);
  }
  // What the originals took is of no size that sampling asks for.
  if (precision.originals == PackedOriginals::kRelease) release_kept_blocks();
}

}  // namespace gld
