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

// Two values at the start give the first slope.
bool is_refresh(int64_t evaluation, int64_t every) {
  return evaluation == 0 || (evaluation - 1) % every == 0;
}

}  // namespace

int64_t extrapolated_encoder_runs(int64_t evaluations, int64_t every) {
  int64_t runs = 0;
  for (int64_t i = 0; i < evaluations; ++i) runs += is_refresh(i, every) ? 1 : 0;
  return runs;
}

ExtrapolatedField::ExtrapolatedField(const DitDh& model, DitScene scene, int64_t every)
    : DitField(model, std::move(scene)), every_(every) {}

// The unconditional branch may have been left out for a while; what it last knew may be older than `every`.
bool ExtrapolatedField::runs(const History& history) const {
  return !history.newest.condition.defined() || is_refresh(evaluation_, every_) ||
         evaluation_ - history.newest.evaluation >= every_;
}

torch::Tensor ExtrapolatedField::condition(const DitNoisyTokens& tokens, const DitTimeRow& time,
                                           DitBranch branch) {
  if (branch == DitBranch::kConditional || evaluation_ < 0) ++evaluation_;
  auto& history = histories_[static_cast<size_t>(branch)];
  const double log_snr = bounded_log_snr(time.time);
  if (runs(history)) {
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
