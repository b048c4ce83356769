#include "gld/base/command_options.h"
#include "train/loop/training_loop.h"

namespace gld {
namespace {

constexpr int64_t kLargest = 1'000'000'000'000;

}  // namespace

void TrainingLoopOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"steps", "optimiser steps of the whole run"}, steps, {1, kLargest});
  visitor.integer({"micro_batches", "micro-batches whose gradients are summed for one step"}, micro_batches,
                  {1, 100000});
  visit_seed(visitor, seed, "everything random in the run");
  visitor.integer({"log_every", "steps between two lines of metrics.jsonl"}, log_every, {1, kLargest});
  visitor.integer({"checkpoint_every", "steps between two checkpoints"}, checkpoint_every, {1, kLargest});
  visitor.integer({"keep_last", "newest checkpoints that are kept, beside the best"}, keep_last, {1, 1000});
  visitor.integer({"validate_every", "steps between two validations"}, validate_every, {1, kLargest});
  visitor.integer(
      {"stop_after_non_finite", "steps in a row with a non-finite loss or gradient that end the run"},
      stop_after_non_finite, {1, 100000});
  visitor.integer({"loader_threads", "threads that prepare data ahead of the step"}, loader_threads,
                  {0, 256});
  visitor.integer({"workers", "micro-batches computed at the same time; the threads are divided among them"},
                  workers, {1, 256});
  visitor.boolean({"shard_optimiser",
                   "of several processes, each keeps moments and moving average of a piece of the parameters "
                   "only (ZeRO-1); adamw and adam"},
                  shard_optimiser);
  visit_choice(visitor,
               {"precision",
                "what the trained model multiplies in, forward and backward; weights, moments, sums and "
                "losses are float32"},
               precision, {"float32", "bfloat16"});
  visitor.group({"learning_rate", "course of the learning rate"}, learning_rate);
  visitor.group({"optimiser", "optimiser, clipping and moving average"}, optimiser);
}

}  // namespace gld
