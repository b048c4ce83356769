#pragma once

#include "gld/cameras/camera.h"
#include "gld/flow/guidance.h"
#include "models/dit/dit_options.h"

#include <cstdint>
#include <string>

namespace gld {

// How the branches of guidance are evaluated, and why.
struct BranchChoice {
  bool batched = false;
  int64_t working_bytes = 0;  // predicted activations of a batch of both (models/cost/cost_model.h)
  std::string reason;         // in words, for reports
};

// Automatic batches small scenes: fewer than 1024 tokens a branch, because linear layers gain nothing from more, and no
// more working memory than allowed (with the published widths and 256 MB, about 660 tokens a branch). The time of a
// guided evaluation, batched over sequential, on two cores with AVX-512, measured before groups held 1536 tokens, is
// 0.94 for configs/tiny (256 tokens a branch); with the published widths 0.90 (128 tokens), 0.97 (360), 0.99 (720) and
// 1.02 (1440).
BranchChoice choose_branches(const GuidanceOptions& guidance, const DitOptions& model,
                             const LatentGrid& grid);

}  // namespace gld
