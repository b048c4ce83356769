#include "models/layers/layer_precision.h"

#include "gld/machine/block_memory.h"

namespace gld {

LayerPrecision layer_precision(ComputePrecision asked, ModelKind kind) {
  LayerPrecision precision;
  if (kind == ModelKind::kGeometry) return precision;
  const bool int8 = asked == ComputePrecision::kInt8;
  const auto beside_int8 =
      has_matrix_unit(ComputePrecision::kBFloat16) ? ComputePrecision::kBFloat16 : ComputePrecision::kFloat32;
  precision.linear = int8 && kind == ModelKind::kBackboneOrDecoder ? beside_int8 : asked;
  precision.attention = int8                                   ? beside_int8
                        : asked == ComputePrecision::kBFloat16 ? ComputePrecision::kBFloat16
                                                               : ComputePrecision::kFloat32;
  return precision;
}

void use_precision(torch::nn::Module& model, const LayerPrecision& precision) {
  for (const auto& parameter : model.parameters()) {
    if (!parameter.is_cpu()) return;
  }
  const auto pack = [&](torch::nn::Module& module) {
    auto* layer = dynamic_cast<PrecisionLayer*>(&module);
    if (layer == nullptr) return;
    layer->use_precision(precision);
    // Layer by layer: packed weights do not lie in the blocks that the originals leave, and both of all layers would be
    // twice the model.
    if (precision.originals == PackedOriginals::kRelease) release_kept_blocks();
  };
  pack(model);
  // Without itself, which LibTorch only gives where it is held by a shared pointer.
  for (const auto& module : model.modules(/*include_self=*/false)) pack(*module);
}

}  // namespace gld
