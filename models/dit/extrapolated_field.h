#pragma once

#include "models/dit/dit_field.h"

#include <array>
#include <cstdint>

#include <torch/types.h>

namespace gld {

// The last evaluation at which a branch's condition encoder ran, where it has not run yet.
constexpr int64_t kNeverRun = -1;
// Whether the condition encoder of a branch runs at this evaluation, counted from 0, or is extrapolated. Evaluations
// without the branch count too: guidance may have left it out for a while, so that what it last knew is older than
// `every`.
bool extrapolated_encoder_runs_at(int64_t evaluation, int64_t last_run, int64_t every);

// The velocity of a DiT^DH whose condition encoder runs at the first two evaluations and then at every `every`th. In
// between, its output before SiLU and time embedding is extrapolated from the last two, linearly in the log-SNR, in
// which the default grid is uniform. With every = 1 this is DitField.
class ExtrapolatedField : public DitField {
 public:
  ExtrapolatedField(const DitDh& model, DitScene scene, int64_t every);

 protected:
  torch::Tensor condition(const DitNoisyTokens& tokens, const DitTimeRow& time, DitBranch branch) override;
  bool needs_encoder(double t, DitBranch branch) const override;

 private:
  struct Known {
    double log_snr = 0;
    int64_t evaluation = kNeverRun;  // number of the evaluation that it comes from
    torch::Tensor condition;
  };
  struct History {
    Known newest, before;
  };

  int64_t every_;
  int64_t evaluation_ = -1;  // every evaluation starts with the conditional branch
  std::array<History, 2> histories_;
};

}  // namespace gld
