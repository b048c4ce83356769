#include "train/loop/micro_batches.h"

#include "gld/tensors/torch_version.h"
#include "train/optim/workers.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>

#include <torch/autograd.h>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

struct Evaluated {
  MicroBatchOutcome outcome;
  torch::Tensor scaled_loss;  // undefined where the loss is not finite
};

Evaluated evaluate(Objective& objective, const MicroBatch& micro, const MicroBatchWork& work) {
  Losses losses;
  {
    std::optional<BFloat16Autocast> autocast;
    // On the CPU the model's layers themselves know (Objective::learn_in).
    if (work.precision == ComputePrecision::kBFloat16 && has_bfloat16_autocast(objective.device())) {
      autocast.emplace(objective.device().type());
    }
    losses = objective.losses(micro.batch, micro.context);
  }
  Evaluated result;
  result.outcome.loss = losses.total.item<double>();
  result.outcome.scenes = static_cast<int64_t>(micro.batch.scenes.size());
  for (const auto& [name, value] : losses.parts)
    result.outcome.parts.emplace_back(name, value.item<double>());
  if (std::isfinite(result.outcome.loss)) result.scaled_loss = losses.total * work.share;
  return result;
}

struct WorkerResult {
  MicroBatchOutcome outcome;
  std::vector<torch::Tensor> gradients;  // one a parameter, undefined where it has none
};

WorkerResult compute(Objective& objective, const std::vector<torch::Tensor>& parameters,
                     const MicroBatch& micro, const MicroBatchWork& work) {
  WorkerResult result;
  const Evaluated evaluated = evaluate(objective, micro, work);
  result.outcome = evaluated.outcome;
  if (evaluated.scaled_loss.defined()) {
    result.gradients = torch::autograd::grad({evaluated.scaled_loss}, parameters, {}, /*retain_graph=*/{},
                                             /*create_graph=*/false, /*allow_unused=*/true);
  }
  return result;
}

std::vector<torch::Tensor> tensors_of(const FlatParameters& parameters) {
  std::vector<torch::Tensor> tensors;
  for (const NamedParameter& item : parameters.parameters()) tensors.push_back(item.parameter);
  return tensors;
}

// Computes them in as many threads as there are workers.
std::vector<WorkerResult> compute_all(Objective& objective, const FlatParameters& parameters,
                                      const std::vector<MicroBatch>& batches, const MicroBatchWork& work) {
  const auto workers = std::min<int64_t>(work.workers, static_cast<int64_t>(batches.size()));
  const auto tensors = tensors_of(parameters);
  std::vector<WorkerResult> results(batches.size());
  in_workers(workers, static_cast<int64_t>(batches.size()), [&](int64_t index) {
    const auto at = static_cast<size_t>(index);
    results[at] = compute(objective, tensors, batches[at], work);
  });
  return results;
}

void add_to(FlatParameters& parameters, const std::vector<torch::Tensor>& gradients) {
  for (size_t i = 0; i < gradients.size(); ++i) {
    if (gradients[i].defined()) parameters.part(parameters.gradients(), i).add_(gradients[i]);
  }
}

// Writes numbers as hexadecimal text: JSON has no infinities, and every bit counts.
std::string number_text(double value) {
  char text[40];
  std::snprintf(text, sizeof(text), "%a", value);
  return text;
}

std::string text_of(const MicroBatchOutcome& outcome) {
  nlohmann::json parts = nlohmann::json::array();
  for (const auto& [name, value] : outcome.parts) parts.push_back({name, number_text(value)});
  return nlohmann::json({{"loss", number_text(outcome.loss)}, {"scenes", outcome.scenes}, {"parts", parts}})
      .dump();
}

MicroBatchOutcome outcome_from(const std::string& text) {
  const auto values = nlohmann::json::parse(text);
  const auto number = [](const nlohmann::json& value) {
    return std::strtod(value.get_ref<const std::string&>().c_str(), nullptr);
  };
  MicroBatchOutcome outcome;
  outcome.loss = number(values.at("loss"));
  outcome.scenes = values.at("scenes").get<int64_t>();
  for (const auto& part : values.at("parts")) {
    outcome.parts.emplace_back(part.at(0).get<std::string>(), number(part.at(1)));
  }
  return outcome;
}

// Puts the outcomes in order from what every process gave: a list of its outcomes, in the order in which it computed
// them.
std::vector<MicroBatchOutcome> outcomes_in_order(const std::vector<std::string>& of_processes,
                                                 int64_t micro_batches) {
  std::vector<nlohmann::json> lists;
  lists.reserve(of_processes.size());
  for (const std::string& text : of_processes) lists.push_back(nlohmann::json::parse(text));
  const auto processes = static_cast<int64_t>(lists.size());
  std::vector<MicroBatchOutcome> outcomes;
  for (int64_t micro = 0; micro < micro_batches; ++micro) {
    const auto& list = lists[static_cast<size_t>(process_of_micro_batch(micro, processes))];
    outcomes.push_back(outcome_from(list.at(static_cast<size_t>(micro / processes)).get<std::string>()));
  }
  return outcomes;
}

}  // namespace

std::vector<MicroBatchOutcome> add_gradients(Objective& objective, FlatParameters& parameters,
                                             const std::vector<MicroBatch>& batches,
                                             const MicroBatchWork& work) {
  std::vector<MicroBatchOutcome> outcomes;
  const auto workers = std::min<int64_t>(work.workers, static_cast<int64_t>(batches.size()));
  if (workers <= 1) {
    for (const MicroBatch& micro : batches) {
      const Evaluated evaluated = evaluate(objective, micro, work);
      outcomes.push_back(evaluated.outcome);
      if (evaluated.scaled_loss.defined()) evaluated.scaled_loss.backward();
    }
    return outcomes;
  }
  const auto results = compute_all(objective, parameters, batches, work);
  const torch::NoGradGuard no_grad;
  for (const WorkerResult& result : results) {
    outcomes.push_back(result.outcome);
    add_to(parameters, result.gradients);
  }
  return outcomes;
}

std::vector<MicroBatchOutcome> add_gradients_of_all(ProcessTeam& team, Objective& objective,
                                                    FlatParameters& parameters,
                                                    const std::vector<MicroBatch>& own, int64_t micro_batches,
                                                    const MicroBatchWork& work) {
  const torch::Tensor& gradients = parameters.gradients();
  auto owned_sum = torch::zeros({team.piece_length(gradients.numel())}, gradients.options());
  // Several workers compute all of this process's micro-batches at once; one takes them in turn, and keeps one
  // gradient.
  std::vector<WorkerResult> at_once;
  if (work.workers > 1) at_once = compute_all(objective, parameters, own, work);
  const auto tensors = tensors_of(parameters);
  std::vector<std::string> mine;
  // Round r adds the micro-batches r * count to (r + 1) * count - 1, one of each process.
  const int64_t rounds = (micro_batches + team.count() - 1) / team.count();
  for (int64_t round = 0; round < rounds; ++round) {
    const auto index = static_cast<size_t>(round);
    parameters.zero_gradients();
    if (index < own.size()) {
      const WorkerResult result =
          work.workers > 1 ? std::move(at_once[index]) : compute(objective, tensors, own[index], work);
      const torch::NoGradGuard no_grad;
      add_to(parameters, result.gradients);
      mine.push_back(text_of(result.outcome));
    }
    // A process without a micro-batch, or with one whose loss is not finite, adds zeros, which change no bit.
    team.add_at_owners(gradients, owned_sum);
  }
  torch::Tensor whole = gradients;
  team.gather_pieces(owned_sum, whole);
  return outcomes_in_order(team.gather(nlohmann::json(mine).dump()), micro_batches);
}

}  // namespace gld
