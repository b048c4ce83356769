#include "models/dit/extrapolated_field.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <torch/types.h>

namespace gld {
namespace {

// The ends have no log-SNR; closer to them nothing changes any more.
double bounded_log_snr(double t) {
  constexpr double kEnd = 1e-3;
  const double inner = std::clamp(t, kEnd, 1 - kEnd);
  return std::log((1 - inner) / inner);
}

}  // namespace

bool extrapolated_encoder_runs_at(int64_t evaluation, int64_t last_run, int64_t every) {
  if (last_run == kNeverRun || evaluation - last_run >= every) return true;
  // Two values at the start give the first slope.
  return evaluation == 0 || (evaluation - 1) % every == 0;
}

ExtrapolatedField::ExtrapolatedField(const DitDh& model, DitScene scene, int64_t every)
    : DitField(model, std::move(scene)), every_(every) {}

bool ExtrapolatedField::needs_encoder(double t, DitBranch branch) const {
  const auto& history = histories_[static_cast<size_t>(branch)];
  return extrapolated_encoder_runs_at(evaluation_, history.newest.evaluation, every_) &&
         DitField::needs_encoder(t, branch);
}

torch::Tensor ExtrapolatedField::condition(const DitNoisyTokens& tokens, const DitTimeRow& time,
                                           DitBranch branch) {
  if (branch == DitBranch::kConditional || evaluation_ < 0) ++evaluation_;
  auto& history = histories_[static_cast<size_t>(branch)];
  const double log_snr = bounded_log_snr(time.time);
  if (extrapolated_encoder_runs_at(evaluation_, history.newest.evaluation, every_)) {
    if (history.newest.condition.defined()) history.before = history.newest;
    history.newest = {log_snr, evaluation_, DitField::condition(tokens, time, branch)};
    return history.newest.condition;
  }
  const double distance = history.newest.log_snr - history.before.log_snr;
  if (!history.before.condition.defined() || distance == 0) return history.newest.condition;
  const double weight = (log_snr - history.newest.log_snr) / distance;
  return history.newest.condition.mul(1 + weight).sub_(history.before.condition, weight);
}

}  // namespace gld
