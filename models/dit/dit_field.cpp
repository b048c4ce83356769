#include "models/dit/dit_field.h"

#include <utility>

#include <c10/util/ScopeExit.h>
#include <torch/types.h>

namespace gld {
namespace {

DitPasses both_branches(const DitScene& scene, const DitTimeRow& time) {
  return {{&scene, &time, DitBranch::kConditional}, {&scene, &time, DitBranch::kUnconditional}};
}

DitBranch other_branch(DitBranch branch) {
  return branch == DitBranch::kConditional ? DitBranch::kUnconditional : DitBranch::kConditional;
}

}  // namespace

DitField::DitField(const DitDh& model, DitScene scene) : model_(model), scene_(std::move(scene)) {}

void DitField::prepare_times(const std::vector<double>& times) {
  torch::NoGradGuard no_grad;
  if (!scene_.savings.time_rows_once) return;
  std::vector<double> missing;
  for (const double time : times) {
    if (time_rows_.count(time) == 0) missing.push_back(time);
  }
  if (missing.empty()) return;
  const auto rows = model_.time_rows(missing);
  for (size_t i = 0; i < missing.size(); ++i) time_rows_[missing[i]] = rows[i];
}

const DitTimeRow& DitField::time_row(double t) {
  const auto found = time_rows_.find(t);
  if (found != time_rows_.end() && scene_.savings.time_rows_once) return found->second;
  // An adaptive solver never comes back to a time; its rows are not kept.
  constexpr size_t kMostRows = 4096;
  if (time_rows_.size() >= kMostRows) time_rows_.clear();
  const int64_t rows = scene_.savings.time_rows_once ? 1 : scene_.grid.views;
  return time_rows_[t] = model_.time_rows({t}, rows).front();
}

bool DitField::keeps_conditions() const {
  return scene_.savings.encoder_reuse && !model_.options().encoder_sees_noisy();
}

bool DitField::is_cached(DitBranch branch, double t) const {
  const auto& cached = cached_[static_cast<size_t>(branch)];
  return keeps_conditions() && cached.condition.defined() && cached.time == t;
}

bool DitField::needs_encoder(double t, DitBranch branch) const { return !is_cached(branch, t); }

torch::Tensor DitField::condition(const DitNoisyTokens& tokens, const DitTimeRow& time, DitBranch branch) {
  const auto index = static_cast<size_t>(branch);
  auto& cached = cached_[index];
  if (is_cached(branch, time.time)) {
    ++counts_.encoder_reused;
    return cached.condition;
  }
  torch::Tensor condition;
  const bool batching = batch_ && batch_->time == time.time;
  if (batching && !batch_->conditions[index].defined() && needs_encoder(time.time, other_branch(branch))) {
    counts_.condition_encoder += 2;
    const auto both = model_.condition_encoder(both_branches(scene_, time), batch_->tokens).chunk(2);
    batch_->conditions = {both[0], both[1]};
  }
  if (batching && batch_->conditions[index].defined()) {
    condition = batch_->conditions[index];
  } else {
    ++counts_.condition_encoder;
    condition = model_.condition_encoder({{&scene_, &time, branch}}, tokens);
  }
  if (keeps_conditions()) cached = {time.time, condition};
  return condition;
}

torch::Tensor DitField::features(const DitNoisyTokens& tokens, const DitTimeRow& time, DitBranch branch) {
  const auto encoded = condition(tokens, time, branch);
  ++counts_.velocity_decoder;
  return model_.velocity_features({{&scene_, &time, branch}}, tokens, encoded);
}

torch::Tensor DitField::branch_velocity(const torch::Tensor& state, double t, DitBranch branch) {
  torch::NoGradGuard no_grad;
  return model_.velocity_from_features(features(model_.embed_noisy(scene_, state), time_row(t), branch),
                                       state, t);
}

torch::Tensor DitField::conditional(const torch::Tensor& state, double t) {
  return branch_velocity(state, t, DitBranch::kConditional);
}

torch::Tensor DitField::unconditional(const torch::Tensor& state, double t) {
  return branch_velocity(state, t, DitBranch::kUnconditional);
}

BranchVelocities DitField::batched_features(const torch::Tensor& state, double t) {
  const DitTimeRow& time = time_row(t);
  const auto shared = model_.embed_noisy(scene_, state);
  DitNoisyTokens own = shared;
  Batch batch;
  batch.time = t;
  batch.tokens = shared;
  if (!scene_.savings.shared_noisy_embedding) {
    own = model_.embed_noisy(scene_, state);
    batch.tokens = {torch::cat({shared.encoder, own.encoder}), torch::cat({shared.decoder, own.decoder})};
  }
  batch_ = batch;
  const auto batch_ends = c10::make_scope_exit([&] { batch_.reset(); });
  const auto conditional = condition(shared, time, DitBranch::kConditional);
  const auto unconditional = condition(own, time, DitBranch::kUnconditional);
  ++counts_.batched;
  counts_.velocity_decoder += 2;
  const auto features = model_.velocity_features(both_branches(scene_, time), batch.tokens,
                                                 torch::cat({conditional, unconditional}));
  const auto parts = features.chunk(2);
  return {parts[0], parts[1]};
}

BranchVelocities DitField::both_features(const torch::Tensor& state, double t) {
  if (batched_) return batched_features(state, t);
  const DitTimeRow& time = time_row(t);
  auto tokens = model_.embed_noisy(scene_, state);
  BranchVelocities result;
  result.conditional = features(tokens, time, DitBranch::kConditional);
  if (!scene_.savings.shared_noisy_embedding) tokens = model_.embed_noisy(scene_, state);
  result.unconditional = features(tokens, time, DitBranch::kUnconditional);
  return result;
}

BranchVelocities DitField::both(const torch::Tensor& state, double t) {
  torch::NoGradGuard no_grad;
  const auto branches = both_features(state, t);
  return {model_.velocity_from_features(branches.conditional, state, t),
          model_.velocity_from_features(branches.unconditional, state, t)};
}

torch::Tensor DitField::guided(const torch::Tensor& state, double t, double scale) {
  torch::NoGradGuard no_grad;
  auto branches = both_features(state, t);
  const bool combined = scene_.savings.combined_last_linear;
  if (!combined) {
    branches = {model_.velocity_from_features(branches.conditional, state, t),
                model_.velocity_from_features(branches.unconditional, state, t)};
  }
  const auto mixed = branches.unconditional + scale * (branches.conditional - branches.unconditional);
  return combined ? model_.velocity_from_features(mixed, state, t) : mixed;
}

}  // namespace gld
