#pragma once

#include "models/dit/dit_field.h"
#include "models/dit/encoder_nodes.h"

#include <array>
#include <vector>

#include <torch/types.h>

namespace gld {

// The velocity of a cascade whose condition encoder runs at a few nodes in flow time only. Without special tokens the
// encoder never sees the noisy latent, so its output, before SiLU and without the time embedding, is a function of
// the flow time that a polynomial follows; the embedding of the evaluation's own time is added as ever. A node is
// evaluated when it is first needed. Memory: one condition, (views, tokens, encoder width), a node and branch.
class NodeField : public DitField {
 public:
  // Throws Error for a model whose condition encoder sees the noisy latent.
  NodeField(const DitDh& model, DitScene scene, EncoderNodes nodes);

 protected:
  torch::Tensor condition(const DitNoisyTokens& tokens, const DitTimeRow& time, DitBranch branch) override;
  bool needs_encoder(double t, DitBranch branch) const override;

 private:
  const torch::Tensor& node_condition(const DitNoisyTokens& tokens, DitBranch branch, size_t node);

  EncoderNodes nodes_;
  std::array<std::vector<DitTimeRow>, 2> rows_;
  std::array<std::vector<torch::Tensor>, 2> conditions_;
};

}  // namespace gld
