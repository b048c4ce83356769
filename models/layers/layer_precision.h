#pragma once

#include "gld/machine/matrix_unit.h"

#include <torch/nn/module.h>

namespace gld {

// What becomes of a layer's weights when they have been packed: they stay, or only their names and shapes do (every
// number NaN), which halves what a model takes in float32 and more in other precisions.
enum class PackedOriginals { kKeep, kRelease };

// What the layers of one model compute in.
struct LayerPrecision {
  ComputePrecision linear = ComputePrecision::kFloat32;
  ComputePrecision attention = ComputePrecision::kFloat32;  // or kBFloat16
  PackedOriginals originals = PackedOriginals::kKeep;
};

// Which models are asked what to compute in, by what their error does.
enum class ModelKind {
  kGenerator,  // of latents: runs at every evaluation of a flow
  // Runs once, and its error stays where it arises: decoders of images, and a reference case's backbone.
  kRunOnce,
  // Runs once, and what follows leans on it: heads for depth, rays and points, and the backbones of sampling, whose
  // features these read.
  kLeanedOn,
};

// The one place that says which layers run in which precision. Of the precision that was asked for:
//   linear layers of blocks    that precision; of kRunOnce bfloat16 in the place of int8, float32 where the processor has
//                              no unit for it: it is a hundredth of a scene's time
//   kLeanedOn                  float32
//   attention                  bfloat16 for bfloat16 and int8 where the processor has a unit for it; else float32
//   LinearPacking::kNever      float32: embeddings of patches, of special tokens and of the flow time, last layers
//   all else                   float32: softmax, norms, residual stream, camera encoding, convolutions
LayerPrecision layer_precision(ComputePrecision asked, ModelKind kind);

// A layer that can compute in another precision, for float32 tensors.
class PrecisionLayer {
 public:
  virtual ~PrecisionLayer() = default;
  // Linear layers that are packed for it refuse gradients from then on.
  virtual void use_precision(const LayerPrecision& precision) = 0;
  // From now on, also while no gradients are recorded: a block that is computed twice to save memory has to give the
  // same bits in both passes.
  // Returns whether this layer follows.
  virtual bool learn_in(ComputePrecision) { return false; }
};

// A block with attention.
class AttentionPrecisionLayer : public PrecisionLayer {
 public:
  void use_precision(const LayerPrecision& precision) override { attention_precision_ = precision.attention; }
  // In bfloat16 where linear layers are.
  bool learn_in(ComputePrecision precision) override;

 protected:
  ComputePrecision attention_precision_ = ComputePrecision::kFloat32;
};

// All such layers of a model. On the CPU weights are packed with the present thread setting; elsewhere bfloat16 alone
// changes something (gld/tensors/transposed_product.h, times_rounded). Once a model: released weights cannot be packed
// again.
void use_precision(torch::nn::Module& model, const LayerPrecision& precision);

// What a model is trained in from now on: float32 or bfloat16 (gld/tensors/learning_product.h). Linear
// layers of blocks follow it, and attention in bfloat16. What stays float32 above does so here. Weights and their
// gradients are float32.
// Returns how many layers that are.
int64_t learn_in(torch::nn::Module& model, ComputePrecision precision);

}  // namespace gld
