#pragma once

#include "ablate/plan/stage_plan.h"

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace gld {

// What a finished stage took.
struct StageCost {
  double seconds = 0;      // of all its runs together: an interrupted one was gone on with
  int64_t peak_bytes = 0;  // largest resident memory
  int64_t disk_bytes = 0;  // of its folder
};

enum class StageState { kDone, kBegun, kMissing };

// A folder a stage, named by its key:
//   stage.json    what it is, with everything that its key is the hash of
//   options.yaml  of the command
//   run/          the command's run folder; of assemble: model/ alone
//   log.txt       what the command printed, all runs of it
//   done.json     its cost; there only when the stage is finished
// And one for all of them, kept_scenes/, which any may do without: what trainings drew and encoded
// (train/data/kept_folder.h).
class StageCache {
 public:
  explicit StageCache(std::filesystem::path folder) : folder_(std::move(folder)) {}

  std::filesystem::path folder(const StageTask& task) const { return folder_ / task.key; }
  std::filesystem::path run(const StageTask& task) const { return folder(task) / "run"; }
  std::filesystem::path model(const StageTask& task) const { return run(task) / "model"; }
  std::filesystem::path kept_scenes() const { return folder_ / "kept_scenes"; }

  StageState state(const StageTask& task) const;
  std::optional<StageCost> cost(const StageTask& task) const;  // of a finished one
  double seconds_spent(const StageTask& task) const;           // by runs that were interrupted

  // Makes the folder with stage.json.
  void begin(const StageTask& task) const;
  void note_seconds_spent(const StageTask& task, double seconds) const;
  void finish(const StageTask& task, const StageCost& cost) const;

 private:
  std::filesystem::path folder_;
};

// Returns of each task whether a result is made of it, itself or through others that are not done: what was removed
// from the cache is not made again for results that are there.
std::vector<bool> needed_tasks(const AblationPlan& plan, const StageCache& cache);

// Where a figure of a plan comes from.
enum class CostSource { kMeasured, kLikeStages, kUnknown };

struct ExpectedCost {
  CostSource source = CostSource::kUnknown;
  StageCost cost;    // the mean of the like ones
  int64_t like = 0;  // how many they are
};

// Returns of a finished stage what it took; of another one it is the mean of the finished ones of its name in this
// plan: other variants and seeds. It is never a guess.
ExpectedCost expected_cost(const AblationPlan& plan, size_t task, const StageCache& cache);

// Returns what is to be run and what that takes, for people: a table with a line a stage and command, then totals.
std::string plan_text(const AblationPlan& plan, const StageCache& cache, int64_t jobs);

}  // namespace gld
