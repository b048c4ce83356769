#include "train/loop/objective.h"

namespace gld {

void visit_start(FieldVisitor& visitor, ModelStart& start) {
  visit_choice(visitor, {"start", "random weights, or those of the bundle (fine-tuning)"}, start,
               {"random", "bundle"});
}

std::vector<std::pair<std::string, double>> Objective::after_step(const StepContext& /*context*/) {
  return {};
}

std::map<std::string, torch::Tensor> Objective::state() const { return {}; }

void Objective::load_state(const std::map<std::string, torch::Tensor>& /*state*/,
                           const std::string& /*where*/) {}

}  // namespace gld
