#pragma once

#include "gld/base/options.h"
#include "gld/flow/velocity_field.h"

#include <cstdint>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// How the two branches of guidance are evaluated: in one pass over the tokens of both, or one after the other. Equal
// results up to rounding.
enum class BranchEvaluation {
  kAutomatic,  // batched where that is faster and its working memory stays below a limit (models/cost/branch_choice.h)
  kBatched,
  kSequential,
};

const std::vector<std::string>& branch_evaluation_names();

// Classifier-free guidance of a velocity (DESIGN.md section 4): v_u + g (v_c - v_u) where the flow time lies in the
// interval, both ends included, else v_c. With g = 1 the unconditional branch never runs.
struct GuidanceOptions : OptionsGroup {
  double guidance_scale = 1.5;
  std::vector<double> guidance_interval{0, 1};
  BranchEvaluation guidance_branches = BranchEvaluation::kAutomatic;
  double guidance_batch_memory = 256;  // megabytes that automatic lets a batch of both branches use

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  // Returns whether the unconditional branch has a part in the velocity at this flow time.
  bool acts_at(double t) const;
};

struct BranchVelocities {
  torch::Tensor conditional;
  torch::Tensor unconditional;
};

// A field that guidance can steer.
class BranchedField {
 public:
  virtual ~BranchedField() = default;
  virtual torch::Tensor conditional(const torch::Tensor& state, double t) = 0;
  virtual torch::Tensor unconditional(const torch::Tensor& state, double t) = 0;
  // Returns both branches; override it where one batched evaluation is cheaper than two.
  virtual BranchVelocities both(const torch::Tensor& state, double t);
  // Returns v_u + g (v_c - v_u); override it where the branches can be combined before the last layer.
  virtual torch::Tensor guided(const torch::Tensor& state, double t, double scale);
};

// What a solve cost by branch.
struct GuidanceReport {
  int64_t evaluations = 0;  // of the guided field
  // Of them with the unconditional branch, which the interval or a scale of 1 leaves out.
  int64_t unconditional = 0;
};

class GuidedField : public VelocityField {
 public:
  // field must outlive this object.
  GuidedField(BranchedField& field, const GuidanceOptions& options);
  torch::Tensor velocity(const torch::Tensor& state, double t) override;

  const GuidanceReport& report() const { return report_; }

 private:
  BranchedField& field_;
  GuidanceOptions options_;
  GuidanceReport report_;
};

}  // namespace gld
