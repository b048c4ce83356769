#pragma once

#include "models/losses/lpips_files.h"
#include "models/losses/perceptual_standin.h"

#include <cstdint>
#include <memory>
#include <string>

#include <torch/types.h>

namespace gld {

struct PerceptualOptions : OptionsGroup {
  double weight = 1.0;
  int64_t start = 0;  // first step with the perceptual loss
  LpipsFiles lpips;   // none: the stand-in (perceptual_standin.h)
  PerceptualStandinOptions standin;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Returns what to tell whoever trains with the stand-in, without its full stop.
std::string standin_note();

// LPIPS where its two files are given, else the stand-in.
class PerceptualLoss {
 public:
  PerceptualLoss(const PerceptualOptions& options, const ParameterPlacement& placement);
  // image, prediction: (batch, 3, height, width), RGB in [0, 1] -> their mean, a scalar. It is differentiable.
  torch::Tensor operator()(const torch::Tensor& image, const torch::Tensor& prediction) const;

 private:
  PerceptualOptions options_;
  std::shared_ptr<Lpips> lpips_;
};

}  // namespace gld
