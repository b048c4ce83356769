#include "models/conditioning/decoder_inputs.h"

#include "gld/base/error.h"

#include <algorithm>

namespace gld {

GeometryInputs geometry_inputs(const LatentSpace& space, const std::vector<torch::Tensor>& raw_levels) {
  GeometryInputs inputs;
  for (const auto& level : raw_levels) inputs.levels.push_back(space.decodable(level));
  inputs.leading = raw_levels.back().narrow(1, 0, space.leading_tokens()).contiguous();
  return inputs;
}

torch::Tensor image_features(const std::vector<torch::Tensor>& levels, const std::vector<int64_t>& decoded) {
  const auto known =
      std::find_if(levels.begin(), levels.end(), [](const torch::Tensor& level) { return level.defined(); });
  if (known == levels.end()) {
    fail({"RGB decoding", "a level that was generated or propagated", "none", "generate one"});
  }
  std::vector<torch::Tensor> features;
  for (const int64_t level : decoded) {
    const auto& made = levels.at(static_cast<size_t>(level));
    features.push_back(made.defined() ? made : torch::zeros_like(*known));
  }
  return torch::cat(features, /*dim=*/2);
}

}  // namespace gld
