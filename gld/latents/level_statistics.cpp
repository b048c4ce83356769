#include "gld/latents/level_statistics.h"

#include "gld/base/error.h"

#include <ATen/ops/cat.h>

namespace gld {
namespace {

template <class Apply>
torch::Tensor by_kind(const LevelStatistics& statistics, const torch::Tensor& tokens, const Apply& apply) {
  const int64_t special = statistics.special_tokens;
  if (special == 0) return apply(statistics.patches, tokens);
  if (!statistics.special) {
    fail({"latent statistics", "statistics of the special tokens in front of the patch tokens", "none",
          "compute them with gld stats, or set num_special_tokens: 0"});
  }
  return at::cat({apply(*statistics.special, tokens.narrow(1, 0, special)),
                  apply(statistics.patches, tokens.slice(1, special))},
                 1);
}

}  // namespace

torch::Tensor LevelStatistics::normalise(const torch::Tensor& tokens) const {
  return by_kind(*this, tokens, [](const LatentStatistics& statistics, const torch::Tensor& x) {
    return statistics.normalise(x);
  });
}

torch::Tensor LevelStatistics::denormalise(const torch::Tensor& latent) const {
  return by_kind(*this, latent, [](const LatentStatistics& statistics, const torch::Tensor& x) {
    return statistics.denormalise(x);
  });
}

LevelStatistics LevelStatistics::to(torch::Device device) const {
  LevelStatistics moved{patches.to(device), std::nullopt, special_tokens};
  if (special) moved.special = special->to(device);
  return moved;
}

}  // namespace gld
