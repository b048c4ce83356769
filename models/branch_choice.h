#pragma once

#include "gld/camera.h"
#include "gld/guidance.h"
#include "models/dit_options.h"

#include <cstdint>
#include <string>

namespace gld {

// How the branches of guidance are evaluated, and why.
struct BranchChoice {
  bool batched = false;
  int64_t working_bytes = 0;  // predicted activations of a batch of both (models/cost_model.h)
  std::string reason;         // in words, for reports
};

BranchChoice choose_branches(const GuidanceOptions& guidance, const DitOptions& model,
                             const LatentGrid& grid);

}  // namespace gld
