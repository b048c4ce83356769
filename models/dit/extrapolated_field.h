#pragma once

#include "models/dit/dit_field.h"

#include <array>
#include <cstdint>

#include <torch/types.h>

namespace gld {

// How often the condition encoder of one branch runs in that many evaluations, each with this branch.
int64_t extrapolated_encoder_runs(int64_t evaluations, int64_t every);

// The velocity of a DiT^DH whose condition encoder runs at the first two evaluations and then at every `every`th. In
// between, its output before SiLU and time embedding is extrapolated from the last two, linearly in the log-SNR, in
// which the default grid is uniform. With every = 1 this is DitField.
class ExtrapolatedField : public DitField {
 public:
  ExtrapolatedField(const DitDh& model, DitScene scene, int64_t every);

 protected:
  torch::Tensor condition(const DitNoisyTokens& tokens, const DitTimeRow& time, DitBranch branch) override;

 private:
  struct Known {
    double log_snr = 0;
    int64_t evaluation = 0;  // number of the evaluation that it comes from
    torch::Tensor condition;
  };
  struct History {
    Known newest, before;
  };

  bool runs(const History& history) const;

  int64_t every_;
  int64_t evaluation_ = -1;  // every evaluation starts with the conditional branch
  std::array<History, 2> histories_;
};

}  // namespace gld
