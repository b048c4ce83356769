#pragma once

#include "gld/distributed/process_team.h"
#include "gld/machine/matrix_unit.h"
#include "train/loop/objective.h"
#include "train/optim/flat_parameters.h"

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

// One micro-batch and the random numbers that belong to it.
struct MicroBatch {
  TrainingBatch batch;
  StepContext context;
};

struct MicroBatchOutcome {
  double loss = 0.0;
  int64_t scenes = 0;
  std::vector<std::pair<std::string, double>> parts;
};

struct MicroBatchWork {
  ComputePrecision precision = ComputePrecision::kFloat32;
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

// Returns the process that computes a micro-batch: they take turns.
inline int64_t process_of_micro_batch(int64_t micro, int64_t processes) { return micro % processes; }

// Does the same with the micro-batches of a step spread over processes: `own` are those of this process, in order.
// Every process has the gradients of all and the losses of all in order; the owner of a piece of the gradients adds it
// up in the order of micro-batches, so that the bits are those of one process that computes all.
std::vector<MicroBatchOutcome> add_gradients_of_all(ProcessTeam& team, Objective& objective,
                                                    FlatParameters& parameters,
                                                    const std::vector<MicroBatch>& own, int64_t micro_batches,
                                                    const MicroBatchWork& work);

}  // namespace gld
