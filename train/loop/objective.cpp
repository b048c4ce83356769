#include "train/loop/objective.h"

namespace gld {

std::vector<std::pair<std::string, double>> Objective::after_step(const StepContext& /*context*/) {
  return {};
}

std::map<std::string, torch::Tensor> Objective::state() const { return {}; }

void Objective::load_state(const std::map<std::string, torch::Tensor>& /*state*/,
                           const std::string& /*where*/) {}

}  // namespace gld
