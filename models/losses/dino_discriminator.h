#pragma once

#include "gld/files/weight_file.h"
#include "models/losses/discriminator.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/types.h>

namespace gld {

// The published DINO ViT-S/8 and the heads that GLD's decoder training uses.
struct DinoDiscriminatorOptions : OptionsGroup {
  int64_t embed_dim = 384;
  int64_t depth = 12;
  int64_t num_heads = 6;
  int64_t patch_size = 8;
  double mlp_ratio = 4.0;
  int64_t image_size = 224;                         // other sizes are resized bilinearly
  std::vector<int64_t> key_depths = {2, 5, 8, 11};  // blocks whose tokens are judged, beside the last
  int64_t kernel_size = 9;                          // of the heads' second convolution, along the tokens

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

class FrozenDino;
class DinoDiscriminatorHead;

// Frozen DINO features are judged by one small trained head per depth (Sauer et al. 2023, StyleGAN-T, section 3.2). Its
// parameters are "heads.N.*" only; DINO is not part of the module's parameters, so it is neither trained nor saved.
class DinoDiscriminator : public Discriminator {
 public:
  DinoDiscriminator(const DinoDiscriminatorOptions& options, const ParameterPlacement& placement);
  ~DinoDiscriminator() override;

  // Loads DINO's weights under their published names, strictly; key biases are zeroed as the published training does.
  void load_dino(const WeightFile& file);
  torch::Tensor logits(const torch::Tensor& images) override;
  void initialise(const torch::Generator& generator) override;

 private:
  std::shared_ptr<FrozenDino> dino_;
  std::vector<std::shared_ptr<DinoDiscriminatorHead>> heads_;
};

}  // namespace gld
