#pragma once

#include "models/dit/dit_dh.h"

#include <map>
#include <string>

#include <torch/types.h>

namespace gld {

// One evaluation of a DiT^DH written down with LibTorch's operations and nothing else: all logits at once, all tokens'
// modulation at once, every element-wise step a pass of its own. The baseline of `gld bench forward` and an oracle for
// the model: it reads the model's parameters by name and its prepared scene, and shares no code with its blocks.
class ComposedDit {
 public:
  // model must outlive this object.
  explicit ComposedDit(const DitDh& model);

  // These do as the functions of DitDh with these names, for one pass; they throw Error for more.
  torch::Tensor condition_encoder(const DitPasses& passes, const DitNoisyTokens& tokens) const;
  torch::Tensor velocity_features(const DitPasses& passes, const DitNoisyTokens& tokens,
                                  const torch::Tensor& condition) const;

 private:
  torch::Tensor linear(const std::string& name, const torch::Tensor& x) const;
  torch::Tensor rms_norm(const std::string& name, const torch::Tensor& x) const;
  torch::Tensor block(int64_t index, int64_t heads, const torch::Tensor& x, const torch::Tensor& modulation,
                      const PropeTables& prope) const;

  const DitDh& model_;
  std::map<std::string, torch::Tensor> parameters_;
};

}  // namespace gld
