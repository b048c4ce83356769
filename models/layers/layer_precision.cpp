#include "models/layers/layer_precision.h"

#include "gld/machine/block_memory.h"

namespace gld {

LayerPrecision layer_precision(ComputePrecision asked, ModelKind kind) {
  LayerPrecision precision;
  if (kind == ModelKind::kLeanedOn) return precision;
  const bool int8 = asked == ComputePrecision::kInt8;
  const auto beside_int8 =
      has_matrix_unit(ComputePrecision::kBFloat16) ? ComputePrecision::kBFloat16 : ComputePrecision::kFloat32;
  precision.linear = int8 && kind == ModelKind::kRunOnce ? beside_int8 : asked;
  precision.attention = int8                                   ? beside_int8
                        : asked == ComputePrecision::kBFloat16 ? ComputePrecision::kBFloat16
                                                               : ComputePrecision::kFloat32;
  return precision;
}

bool AttentionPrecisionLayer::learn_in(ComputePrecision precision) {
  const bool reduced = precision == ComputePrecision::kBFloat16;
  attention_precision_ = reduced ? precision : ComputePrecision::kFloat32;
  return reduced;
}

namespace {

template <class Function>
void for_each_layer(torch::nn::Module& model, const Function& function) {
  const auto visit = [&](torch::nn::Module& module) {
    if (auto* layer = dynamic_cast<PrecisionLayer*>(&module)) function(*layer);
  };
  visit(model);
  // Without itself, which LibTorch only gives where it is held by a shared pointer.
  for (const auto& module : model.modules(/*include_self=*/false)) visit(*module);
}

}  // namespace

void use_precision(torch::nn::Module& model, const LayerPrecision& precision) {
  for_each_layer(model, [&](PrecisionLayer& layer) {
    layer.use_precision(precision);
    // This goes layer by layer: packed weights do not lie in the blocks that the originals leave, and both of all
    // layers would be twice the model.
    if (precision.originals == PackedOriginals::kRelease) release_kept_blocks();
  });
}

int64_t learn_in(torch::nn::Module& model, ComputePrecision precision) {
  int64_t following = 0;
  for_each_layer(model, [&](PrecisionLayer& layer) { following += layer.learn_in(precision) ? 1 : 0; });
  return following;
}

}  // namespace gld
