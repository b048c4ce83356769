#pragma once

#include "models/layers/layers.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Consecutive views of a (views, tokens, channels) tensor.
struct ViewGroup {
  int64_t first = 0;
  int64_t count = 0;
};

// Returns how many views a group has while sampling: equal groups of at most 1536 tokens, or of one view, so that what
// a group makes on its way stays small. A product packs its weights anew for every so many rows (kRowsPackedAtOnce in
// gld/kernels/product_shares.h): 1440 rows, two equal packs, are 7 % faster than 900 and then 540.
int64_t views_per_group(int64_t views, int64_t tokens_per_view);

// Calls part for groups of views and puts the results, (views of the group, ...) each, together. While gradients
// are recorded there is one group.
torch::Tensor by_view_groups(const torch::Tensor& x,
                             const std::function<torch::Tensor(const ViewGroup&)>& part);

// AdaLN makes shift, scale and gate from this: ready rows, or one condition a token that still has to be multiplied
// (all tokens' products at once would be gigabytes).
struct Modulation {
  torch::Tensor rows;        // (1 or views, parts * channels)
  torch::Tensor activation;  // (views, tokens, channels), SiLU of the condition; used where rows is undefined
};

// AdaLN (Peebles and Xie 2023) is a linear layer, registered as "1" as in the checkpoint, from SiLU of a condition to
// `parts` vectors of `channels`.
class AdaptiveNorm : public torch::nn::Module {
 public:
  AdaptiveNorm(int64_t channels, int64_t parts, const ParameterPlacement& placement);

  // Makes of SiLU of few conditions, (rows, channels), the rows of a Modulation.
  torch::Tensor rows(const torch::Tensor& activation) const;
  // Returns vectors first .. first + count - 1 for a group of views; each broadcasts to (views, tokens, channels).
  std::vector<torch::Tensor> parts(const Modulation& modulation, const ViewGroup& group, int64_t first,
                                   int64_t count) const;

 private:
  int64_t channels_;
  std::shared_ptr<Linear> linear_;
};

}  // namespace gld
