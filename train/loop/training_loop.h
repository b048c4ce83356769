#pragma once

#include "gld/base/options.h"
#include "gld/distributed/process_team.h"
#include "train/data/batch_prefetcher.h"
#include "train/loop/micro_batches.h"
#include "train/loop/objective.h"
#include "train/optim/learning_rate.h"
#include "train/optim/optimiser.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace gld {

struct TrainingLoopOptions : OptionsGroup {
  int64_t steps = 100000;
  int64_t micro_batches = 1;
  int64_t seed = 0;
  int64_t log_every = 20;
  int64_t checkpoint_every = 1000;
  int64_t keep_last = 3;
  int64_t validate_every = 1000;
  int64_t stop_after_non_finite = 10;
  int64_t loader_threads = 1;
  int64_t workers = 1;
  bool shard_optimiser = false;
  ComputePrecision precision = ComputePrecision::kFloat32;  // not int8
  LearningRateOptions learning_rate;
  OptimiserOptions optimiser;

  void visit(FieldVisitor& visitor) override;
};

enum class TrainingStart {
  kFresh,   // Error when the folder already has checkpoints
  kResume,  // Error when it has none
};

// Where a run gets its work from and where it writes.
struct TrainingRun {
  std::filesystem::path folder;  // exists; of several processes rank 0 reads and writes there
  Objective* objective = nullptr;
  std::shared_ptr<const TrainingBatchSource> data;
  std::vector<TrainingScene> validation_scenes;
  bool begins_trained =
      false;  // fine-tuning: a fresh run validates before its first step too, to be compared with
  DType export_dtype = DType::kFloat32;  // of the exported model
  // Draws the rows of a validation (a contact sheet) into a file without its ending; may be empty.
  std::function<void(const Validation& validation, const std::filesystem::path& file)> draw_validation;
  // Called after every step where metrics.jsonl is written; lines of that come every log_every steps. May be empty.
  std::function<void()> on_step;
  // Called where a stop ends the process in the middle of a step, by another thread, after the checkpoint; may be
  // empty, and must not throw. A stop between two steps throws Interrupted.
  std::function<void()> on_stop;
  // These processes train together, each with the same model, options and data; null stands for this one alone.
  // Micro-batches are spread over them, and nothing else changes: the bits are those of one process on the CPU with as
  // many threads.
  ProcessTeam* team = nullptr;
  // This describes the model beside the options of the run, model.yaml. Checkpoints keep it, and going on with another
  // one is an Error, but for the keys ("model.level1_time_shift.training") of may_change. Null stands for nothing.
  const OptionsGroup* model = nullptr;
  const OptionsGroup* model_defaults =
      nullptr;  // as constructed: of what a checkpoint's program did not have; or null
  std::vector<std::string> may_change;
  // SHA-256 of the frozen parts that the objective is trained on, by name. Checkpoints keep them too, and going on with
  // others is an Error unless allowed.
  std::map<std::string, std::string> trained_on;
  bool allow_other_parts = false;
};

struct TrainingSummary {
  int64_t steps_done = 0;  // of the whole run
  int64_t steps_this_call = 0;
  int64_t skipped_steps = 0;                               // non-finite loss or gradient, whole run
  double seconds = 0.0;                                    // of the whole run
  double final_loss = 0.0;                                 // of the last finite step
  std::vector<std::pair<std::string, double>> validation;  // the last one
  std::vector<std::string> messages;  // what a user should know: damaged checkpoints passed over
};

// Throws the Error of a start that the folder does not allow; touches nothing.
void check_training_start(const std::filesystem::path& folder, TrainingStart start);

// The one training loop. Writes into run.folder: checkpoints/, metrics.jsonl, loss.svg and .png, validation/, model/
// (the exported bundle, at the end). Steps whose loss or gradient is not finite are skipped and counted;
// stop_after_non_finite of them in a row are an Error, with the batches that may be the cause saved in non_finite/. On
// Ctrl-C a checkpoint is written and Interrupted is thrown. On the CPU with one thread count, N steps in one call and
// in several with kResume give the same bytes.
TrainingSummary train(const TrainingRun& run, const TrainingLoopOptions& options, TrainingStart start);

}  // namespace gld
