#include "models/latent_spaces/latent_space.h"

#include "gld/base/error.h"

namespace gld {

torch::Tensor generated_tokens(const torch::Tensor& raw_level, int64_t leading_tokens,
                               int64_t special_tokens) {
  if (special_tokens == 0) return raw_level.slice(1, leading_tokens).contiguous();
  if (special_tokens != leading_tokens) {
    fail({"num_special_tokens",
          "0, or " + std::to_string(leading_tokens) + ", the backbone's tokens in front of the patches",
          std::to_string(special_tokens), "change it in model.yaml"});
  }
  return raw_level;
}

}  // namespace gld
