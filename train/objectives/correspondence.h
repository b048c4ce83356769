#pragma once

#include "gld/attention/attention.h"
#include "train/data/training_scene.h"

#include <cstdint>

#include <torch/types.h>

namespace gld {

// Where the surface that a patch token shows is seen in other views, from exact depth and cameras.
//
// shares: (views, tokens, views, tokens), float32. Of a token's points (a 4x4 grid of pixels), the share that lands in
// each token of each other view and is seen there: its depth agrees with that view's own to 3 %, so that occluded
// points do not count. Zero within a view.
struct TokenCorrespondence {
  torch::Tensor shares;
};

// Throws Error when the scene has no depth.
TokenCorrespondence token_correspondence(const TrainingScene& scene, int64_t patch_size);

// Which tokens of a block's attention a loss looks at.
struct CorrespondenceKeys {
  int64_t prefix_tokens = 0;  // special tokens in front of each view's patch tokens
  int64_t views = 0;          // keys are those of the first views only: the sources, or all
};

// Returns how far a block's attention is from true correspondence (CAMEO): cross-entropy between a token's shares among
// the keys' views other than its own and the attention's mean over heads among the same keys. The mean leaves it to the
// heads which of them finds the place. It is the mean over the tokens that are seen in another view; undefined when
// there are none.
torch::Tensor correspondence_loss(const AttentionTap& tap, const TokenCorrespondence& truth,
                                  const CorrespondenceKeys& keys);

}  // namespace gld
