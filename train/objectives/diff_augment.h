#pragma once

#include "gld/base/options.h"

#include <torch/types.h>

namespace gld {

struct DiffAugmentOptions : OptionsGroup {
  double probability = 1.0;  // of each kind, drawn once a call
  double cutout = 0.0;       // side of the cut-out square over the image's side; 0: none

  void visit(FieldVisitor& visitor) override;
};

// Differentiable augmentation (Zhao et al. 2020): what the discriminator sees is shifted by up to an eighth of
// the image, changed in brightness, saturation and contrast, and cut out, each image by its own amount.
// images: (batch, 3, height, width) -> the same shape. The generator is on the CPU.
torch::Tensor diff_augment(const torch::Tensor& images, const DiffAugmentOptions& options,
                           torch::Generator& generator);

}  // namespace gld
