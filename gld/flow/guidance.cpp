#include "gld/flow/guidance.h"

#include "gld/base/error.h"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {

const std::vector<std::string>& branch_evaluation_names() {
  static const std::vector<std::string> names{"automatic", "batched", "sequential"};
  return names;
}

void GuidanceOptions::visit(FieldVisitor& visitor) {
  visitor.real({"guidance_scale", "guidance scale; 1 runs no unconditional branch"}, guidance_scale,
               {0, 1000});
  visitor.reals({"guidance_interval", "flow times [low, high] where guidance acts, both included"},
                guidance_interval, {0, 1});
  visitor.real({"guidance_tolerance",
                "leave out the unconditional branch where guidance adds less than this, relative; 0 never"},
               guidance_tolerance, {0, 1});
  visit_choice(visitor,
               {"guidance_branches",
                "both branches in one pass, or one after the other; automatic: in one for small scenes"},
               guidance_branches, branch_evaluation_names());
  visitor.real(
      {"guidance_batch_memory", "megabytes of working memory up to which automatic batches the branches"},
      guidance_batch_memory, {0, 1e9});
}

void GuidanceOptions::check() const {
  if (guidance_interval.size() != 2 || guidance_interval[0] > guidance_interval[1]) {
    fail({"guidance_interval", "two flow times, the lower first",
          fmt::format("[{}]", fmt::join(guidance_interval, ", ")), "write for example [0, 1]"});
  }
}

bool GuidanceOptions::acts_at(double t) const {
  return guidance_scale != 1 && t >= guidance_interval[0] && t <= guidance_interval[1];
}

BranchVelocities BranchedField::both(const torch::Tensor& state, double t) {
  return {conditional(state, t), unconditional(state, t)};
}

torch::Tensor BranchedField::guided(const torch::Tensor& state, double t, double scale) {
  const auto branches = both(state, t);
  return branches.unconditional + scale * (branches.conditional - branches.unconditional);
}

GuidedField::GuidedField(BranchedField& field, const GuidanceOptions& options)
    : field_(field), options_(options) {
  options_.check();
}

torch::Tensor GuidedField::velocity(const torch::Tensor& state, double t) {
  ++report_.evaluations;
  if (!options_.acts_at(t)) {
    ++report_.outside_interval;
    return field_.conditional(state, t);
  }
  if (options_.guidance_tolerance > 0) return adaptive_velocity(state, t);
  ++report_.unconditional;
  return field_.guided(state, t, options_.guidance_scale);
}

torch::Tensor GuidedField::adaptive_velocity(const torch::Tensor& state, double t) {
  constexpr int64_t kEvaluationsBetweenChecks = 4;
  if (agreed_ && ++since_check_ < kEvaluationsBetweenChecks) {
    ++report_.dropped;
    return field_.conditional(state, t);
  }
  since_check_ = 0;
  ++report_.unconditional;
  const auto branches = field_.both(state, t);
  const auto difference = branches.conditional - branches.unconditional;
  const double added = std::abs(options_.guidance_scale - 1) * difference.norm().item<double>();
  const double relative = added / std::max(branches.conditional.norm().item<double>(), 1e-300);
  agreed_ = relative < options_.guidance_tolerance;
  if (agreed_) report_.largest_neglected = std::max(report_.largest_neglected, relative);
  return branches.unconditional + options_.guidance_scale * difference;
}

}  // namespace gld
