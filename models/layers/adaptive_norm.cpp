#include "models/layers/adaptive_norm.h"

#include <algorithm>

#include <torch/types.h>

namespace gld {

int64_t views_per_group(int64_t views, int64_t tokens_per_view) {
  constexpr int64_t kMostTokens = 1536;
  const int64_t most = std::max<int64_t>(1, kMostTokens / std::max<int64_t>(1, tokens_per_view));
  const int64_t groups = std::max<int64_t>(1, (views + most - 1) / most);
  return std::max<int64_t>(1, (views + groups - 1) / groups);
}

torch::Tensor by_view_groups(const torch::Tensor& x,
                             const std::function<torch::Tensor(const ViewGroup&)>& part) {
  const int64_t views = x.size(0);
  const int64_t size = torch::GradMode::is_enabled() ? views : views_per_group(views, x.size(1));
  if (size >= views) return part({0, views});
  torch::Tensor whole;
  for (int64_t first = 0; first < views; first += size) {
    const ViewGroup group{first, std::min(size, views - first)};
    const auto result = part(group);
    if (!whole.defined()) {
      auto shape = result.sizes().vec();
      shape[0] = views;
      whole = torch::empty(shape, result.options());
    }
    whole.narrow(0, group.first, group.count).copy_(result);
  }
  return whole;
}

AdaptiveNorm::AdaptiveNorm(int64_t channels, int64_t parts, const ParameterPlacement& placement)
    : channels_(channels) {
  LinearSizes sizes{channels, parts * channels};
  sizes.parts = parts;
  linear_ = register_module("1", std::make_shared<Linear>(sizes, placement));
}

torch::Tensor AdaptiveNorm::rows(const torch::Tensor& activation) const {
  return linear_->forward(activation);
}

std::vector<torch::Tensor> AdaptiveNorm::parts(const Modulation& modulation, const ViewGroup& group,
                                               int64_t first, int64_t count) const {
  torch::Tensor vectors;
  if (modulation.rows.defined()) {
    const auto rows =
        modulation.rows.size(0) == 1 ? modulation.rows : modulation.rows.narrow(0, group.first, group.count);
    vectors = rows.narrow(1, first * channels_, count * channels_).unsqueeze(1);
  } else {
    const auto activation = modulation.activation.narrow(0, group.first, group.count);
    vectors = linear_->forward_parts(activation, first, count);
  }
  return vectors.chunk(count, -1);
}

}  // namespace gld
