#pragma once

#include "gld/flow/guidance.h"
#include "models/dit/dit_dh.h"

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include <torch/types.h>

namespace gld {

// How often each part of a DiT^DH ran, for reports.
struct DitCounts {
  int64_t condition_encoder = 0;
  int64_t velocity_decoder = 0;
  int64_t batched = 0;         // evaluations of both branches in one pass
  int64_t encoder_reused = 0;  // evaluations whose condition came from an earlier one at the same flow time
};

// The velocity of one scene by a DiT^DH, in both branches of guidance. State: (views, tokens, channels), special
// tokens first. Without gradients.
class DitField : public BranchedField {
 public:
  // model must outlive this object; scene is one of its own (DitDh::prepare_scene).
  DitField(const DitDh& model, DitScene scene);

  torch::Tensor conditional(const torch::Tensor& state, double t) override;
  torch::Tensor unconditional(const torch::Tensor& state, double t) override;
  BranchVelocities both(const torch::Tensor& state, double t) override;
  // Combines the branches before the last linear layer: the result is the same up to rounding.
  torch::Tensor guided(const torch::Tensor& state, double t, double scale) override;

  // Evaluates both branches in one pass over the tokens of both where guidance asks for both. It is off to begin with.
  void set_batched(bool batched) { batched_ = batched; }

  // Computes the rows of these flow times in one product; others are computed when they come.
  void prepare_times(const std::vector<double>& times);

  const DitScene& scene() const { return scene_; }
  const DitCounts& counts() const { return counts_; }

 protected:
  // Returns the condition encoder's output before flow time and SiLU. Override it to approximate it. In a batched
  // evaluation this implementation, asked for one branch at the evaluation's own time, computes the other with it where
  // that one needs the encoder too, and has it ready.
  virtual torch::Tensor condition(const DitNoisyTokens& tokens, const DitTimeRow& time, DitBranch branch);

  // Returns whether condition() asked for this branch in the present evaluation, at flow time t, would run the encoder
  // at t. It goes with condition(): override both.
  virtual bool needs_encoder(double t, DitBranch branch) const;

  const DitDh& model() const { return model_; }

 private:
  const DitTimeRow& time_row(double t);
  torch::Tensor features(const DitNoisyTokens& tokens, const DitTimeRow& time, DitBranch branch);
  torch::Tensor branch_velocity(const torch::Tensor& state, double t, DitBranch branch);
  BranchVelocities both_features(const torch::Tensor& state, double t);
  BranchVelocities batched_features(const torch::Tensor& state, double t);
  bool keeps_conditions() const;
  bool is_cached(DitBranch branch, double t) const;

  struct CachedCondition {
    double time = -1;
    torch::Tensor condition;
  };

  // A batched evaluation on its way.
  struct Batch {
    double time = 0;
    DitNoisyTokens tokens;                    // of both branches, or shared by them
    std::array<torch::Tensor, 2> conditions;  // by branch; undefined until one is asked for
  };

  const DitDh& model_;
  DitScene scene_;
  bool batched_ = false;
  std::optional<Batch> batch_;
  DitCounts counts_;
  std::map<double, DitTimeRow> time_rows_;
  std::array<CachedCondition, 2> cached_;  // by branch
};

}  // namespace gld
