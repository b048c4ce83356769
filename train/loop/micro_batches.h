#pragma once

#include "train/loop/objective.h"
#include "train/optim/flat_parameters.h"

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

enum class Precision { kFloat32, kBFloat16 };

// One micro-batch and the random numbers that belong to it.
struct MicroBatch {
  TrainingBatch batch;
  StepContext context;
};

struct MicroBatchOutcome {
  double loss = 0.0;
  std::vector<std::pair<std::string, double>> parts;
};

struct MicroBatchWork {
  Precision precision = Precision::kFloat32;
  int64_t workers = 1;
  double share = 1.0;  // each loss is multiplied by it before its gradients are taken
};

// Adds the gradients of all micro-batches to parameters.gradients() and returns their losses in order. Several workers
// are threads that compute micro-batches at the same time: small models leave most of a processor idle when one
// micro-batch is spread over it. With several workers every micro-batch has gradients of its own, added up in order,
// so that timing does not change the result. A micro-batch whose loss is not finite adds nothing.
std::vector<MicroBatchOutcome> add_gradients(Objective& objective, FlatParameters& parameters,
                                             const std::vector<MicroBatch>& batches,
                                             const MicroBatchWork& work);

}  // namespace gld
