#include "gld/flow/guidance.h"

#include "gld/base/error.h"

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
  if (!options_.acts_at(t)) return field_.conditional(state, t);
  ++report_.unconditional;
  return field_.guided(state, t, options_.guidance_scale);
}

}  // namespace gld
