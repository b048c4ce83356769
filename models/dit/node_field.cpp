#include "models/dit/node_field.h"

#include "gld/base/error.h"

#include <algorithm>
#include <utility>

#include <torch/types.h>

namespace gld {

NodeField::NodeField(const DitDh& model, DitScene scene, EncoderNodes nodes)
    : DitField(model, std::move(scene)), nodes_(std::move(nodes)) {
  if (model.options().encoder_sees_noisy()) {
    fail({"cascade_encoder_nodes", "a cascade whose condition encoder sees the flow time alone",
          "a model whose condition encoder sees the noisy latent too", "leave it at 0"});
  }
  const torch::NoGradGuard no_gradients;
  const int64_t rows = this->scene().savings.time_rows_once ? 1 : this->scene().grid.views;
  for (size_t branch = 0; branch < nodes_.size(); ++branch) {
    if (!nodes_[branch].empty()) rows_[branch] = model.time_rows(nodes_[branch], rows);
    conditions_[branch].resize(nodes_[branch].size());
  }
}

const torch::Tensor& NodeField::node_condition(const DitNoisyTokens& tokens, DitBranch branch, size_t node) {
  const auto index = static_cast<size_t>(branch);
  auto& condition = conditions_[index][node];
  if (!condition.defined()) condition = DitField::condition(tokens, rows_[index][node], branch);
  return condition;
}

bool NodeField::needs_encoder(double t, DitBranch branch) const {
  const auto index = static_cast<size_t>(branch);
  const auto& nodes = nodes_[index];
  if (nodes.empty()) return DitField::needs_encoder(t, branch);
  // Between nodes a polynomial stands for the encoder; at one its weight alone is not 0.
  const auto node = std::find(nodes.begin(), nodes.end(), t);
  return node != nodes.end() && !conditions_[index][node - nodes.begin()].defined();
}

torch::Tensor NodeField::condition(const DitNoisyTokens& tokens, const DitTimeRow& time, DitBranch branch) {
  const auto& nodes = nodes_[static_cast<size_t>(branch)];
  // Only a caller that evaluates a branch where guidance does not act gets here.
  if (nodes.empty()) return DitField::condition(tokens, time, branch);
  const auto weights = interpolation_weights(nodes, time.time);
  torch::Tensor sum;
  for (size_t i = 0; i < nodes.size(); ++i) {
    if (weights[i] == 0) continue;
    const auto& value = node_condition(tokens, branch, i);
    if (weights[i] == 1) return value;
    if (sum.defined()) {
      sum.add_(value, weights[i]);
    } else {
      sum = value * weights[i];
    }
  }
  return sum;
}

}  // namespace gld
