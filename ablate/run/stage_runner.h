#pragma once

#include "ablate/plan/stage_cache.h"
#include "ablate/plan/stage_plan.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace gld {

struct RunningOptions {
  std::filesystem::path program;
  int64_t jobs = 1;
  int64_t threads = 1;  // of each
  // In this folder progress.json says how far the tasks are together; where it is empty, nothing does.
  std::filesystem::path progress_folder;
  // Called with each task that is done, those of before included, as soon as it is; an Error that it throws stops the
  // running ones, which go on next time, and is passed on. May be empty.
  std::function<void(size_t task)> check_done;
};

struct TaskOutcome {
  bool done = false;
  bool needed = true;   // not where all that would take it is done, though it is not there
  std::string problem;  // of a failed task, or of the one before it that failed: one sentence
};

// Runs what is not done and needed (needed_tasks()), each task behind those that it needs, up to `jobs` at a time, and
// those that are to be alone alone. A task that fails costs those that need it, and no other. Every stage is a process
// of its own: killed, or killed together with this process, it is gone on with next time (training) or begun again.
// There is one outcome a task. Throws Interrupted after Ctrl-C or SIGTERM, when the running stages have stopped.
std::vector<TaskOutcome> run_tasks(const AblationPlan& plan, const StageCache& cache,
                                   const RunningOptions& options);

// Returns the command line of a task, as it is run and as reports show it.
std::vector<std::string> command_line_of(const StageTask& task, const AblationPlan& plan,
                                         const StageCache& cache, const RunningOptions& options, bool resume);

}  // namespace gld
