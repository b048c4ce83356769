#include "train/loop/micro_batches.h"

#include "gld/tensors/torch_version.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <exception>
#include <optional>
#include <thread>

#include <torch/autograd.h>

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
    if (work.precision == Precision::kBFloat16) autocast.emplace(objective.device().type());
    losses = objective.losses(micro.batch, micro.context);
  }
  Evaluated result;
  result.outcome.loss = losses.total.item<double>();
  for (const auto& [name, value] : losses.parts)
    result.outcome.parts.emplace_back(name, value.item<double>());
  if (std::isfinite(result.outcome.loss)) result.scaled_loss = losses.total * work.share;
  return result;
}

struct WorkerResult {
  MicroBatchOutcome outcome;
  std::vector<torch::Tensor> gradients;  // one a parameter, undefined where it has none
  std::exception_ptr error;
};

WorkerResult compute(Objective& objective, const std::vector<torch::Tensor>& parameters,
                     const MicroBatch& micro, const MicroBatchWork& work) {
  WorkerResult result;
  try {
    const Evaluated evaluated = evaluate(objective, micro, work);
    result.outcome = evaluated.outcome;
    if (evaluated.scaled_loss.defined()) {
      result.gradients =
          torch::autograd::grad({evaluated.scaled_loss}, parameters, {}, /*retain_graph=*/c10::nullopt,
                                /*create_graph=*/false, /*allow_unused=*/true);
    }
  } catch (...) {
    result.error = std::current_exception();
  }
  return result;
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
  std::vector<torch::Tensor> tensors;
  for (const NamedParameter& item : parameters.parameters()) tensors.push_back(item.parameter);
  std::vector<WorkerResult> results(batches.size());
  std::atomic<size_t> next{0};
  std::vector<std::thread> threads;
  for (int64_t worker = 0; worker < workers; ++worker) {
    threads.emplace_back([&] {
      for (size_t index = next++; index < batches.size(); index = next++) {
        results[index] = compute(objective, tensors, batches[index], work);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  const torch::NoGradGuard no_grad;
  for (const WorkerResult& result : results) {
    if (result.error) std::rethrow_exception(result.error);
    outcomes.push_back(result.outcome);
    for (size_t i = 0; i < result.gradients.size(); ++i) {
      if (result.gradients[i].defined()) parameters.part(parameters.gradients(), i).add_(result.gradients[i]);
    }
  }
  return outcomes;
}

}  // namespace gld
