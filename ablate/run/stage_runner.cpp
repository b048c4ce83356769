#include "ablate/run/stage_runner.h"

#include "ablate/configuration/ablation.h"
#include "ablate/run/assembled_bundle.h"
#include "ablate/run/stage_lock.h"
#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/child_process.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/printable_text.h"
#include "gld/base/yaml_text.h"
#include "gld/report/progress.h"
#include "models/bundle/bundle.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <memory>
#include <set>
#include <sstream>
#include <thread>

#include <fmt/format.h>

namespace gld {
namespace {

namespace fs = std::filesystem;

constexpr std::chrono::seconds kBetweenLooks(1);

bool has_training_checkpoint(const fs::path& run) {
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(run / "checkpoints", error)) {
    const std::string name = entry.path().filename().string();
    if (name.rfind("step_", 0) == 0 && entry.path().extension() == ".safetensors") return true;
  }
  return false;
}

fs::path newest_checkpoint(const fs::path& run) {
  fs::path newest;
  for (const auto& entry : fs::directory_iterator(run / "checkpoints")) {
    const std::string name = entry.path().filename().string();
    if (name.rfind("step_", 0) == 0 && (newest.empty() || name > newest.filename().string()))
      newest = entry.path();
  }
  return newest;
}

// Makes a copy of a finished training that another one goes on with: its newest checkpoint and what belongs to it.
void branch_training(const fs::path& from, const fs::path& to) {
  AtomicFolder folder(to);
  fs::create_directory(folder.temporary() / "checkpoints");
  const fs::path checkpoint = newest_checkpoint(from);
  if (checkpoint.empty()) {
    fail({from.string(), "a checkpoint to go on from", "none", "let the stage keep one (loop.keep_last)"});
  }
  copy_file_atomically(checkpoint, folder.temporary() / "checkpoints" / checkpoint.filename());
  for (const char* name : {"config.yaml", "metrics.jsonl"})
    copy_file_atomically(from / name, folder.temporary() / name);
  folder.commit();
}

int64_t size_on_disk(const fs::path& folder) {
  int64_t bytes = 0;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file()) bytes += static_cast<int64_t>(entry.file_size());
  }
  return bytes;
}

// Of the end of a log, which may be long.
std::string last_line(const fs::path& log) {
  constexpr std::streamoff kEnd = 4096;
  std::ifstream file(log, std::ios::binary | std::ios::ate);
  if (!file) return "";
  file.seekg(std::max<std::streamoff>(0, static_cast<std::streamoff>(file.tellg()) - kEnd));
  std::string last;
  for (std::string line; std::getline(file, line);) {
    if (line.find_first_not_of(" \t\r") != std::string::npos) last = line;
  }
  return printable_text(last);
}

// Returns at most sixty letters of a line, in whole words.
std::string shortened(const std::string& line) {
  constexpr size_t kLongest = 60;
  if (line.size() <= kLongest) return line;
  const size_t space = line.rfind(' ', kLongest);
  const size_t end = space == std::string::npos ? kLongest : line.find_last_not_of(' ', space) + 1;
  return line.substr(0, end) + " ...";
}

std::string with_folders(std::string text, const StageTask& task, const AblationPlan& plan,
                         const StageCache& cache) {
  for (const auto& [name, number] : task.named) {
    const std::string from = "${" + name + "}";
    const std::string to = cache.run(plan.tasks[number]).string();
    for (size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size())) {
      text.replace(at, from.size(), to);
    }
  }
  return text;
}

fs::path model_folder(const StageTask& task, const AblationPlan& plan, const StageCache& cache) {
  return task.model ? cache.model(plan.tasks[*task.model]) : task.base_model;
}

// The scheduler's view of a task.
struct RunningTask {
  size_t number = 0;
  std::unique_ptr<StageLock> lock;
  std::unique_ptr<ChildProcess> process;
};

class Scheduler {
 public:
  Scheduler(const AblationPlan& plan, const StageCache& cache, const RunningOptions& options)
      : plan_(plan), cache_(cache), options_(options), outcomes_(plan.tasks.size()) {}

  std::vector<TaskOutcome> run() {
    const std::vector<bool> needed = needed_tasks(plan_, cache_);
    for (size_t number = 0; number < plan_.tasks.size(); ++number) {
      if (cache_.state(plan_.tasks[number]) == StageState::kDone) {
        outcomes_[number].done = true;
        check_done(number);
      } else if (needed[number]) {
        waiting_.push_back(number);
      } else {
        outcomes_[number].needed = false;
      }
    }
    if (waiting_.empty()) return outcomes_;
    try {
      start();
      // A percent is a hundredth of all stages, so that one of an hour is not nothing until it is done.
      Progress progress({"ablation, percent", 100, percent_done(), options_.progress_folder});
      auto looked = std::chrono::steady_clock::now();
      int64_t percent = percent_done();
      while (!waiting_.empty() || !running_.empty()) {
        if (interrupt_requested()) stop();
        const bool ended = collect();
        start();
        // Stages say how far they are in a file each.
        if (const auto now = std::chrono::steady_clock::now(); ended || now - looked >= kBetweenLooks) {
          looked = now;
          percent = percent_done();
        }
        progress.update(percent, note());
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
      }
      progress.finish();
    } catch (...) {
      stop_running();
      throw;
    }
    return outcomes_;
  }

 private:
  int64_t ended() const { return static_cast<int64_t>(outcomes_.size() - waiting_.size() - running_.size()); }

  void check_done(size_t number) const {
    if (options_.check_done && outcomes_[number].done) options_.check_done(number);
  }

  // The percentage is that of all stages together, with what the running ones say of themselves; it is at most 99 as
  // long as one runs.
  int64_t percent_done() const {
    double done = static_cast<double>(ended());
    for (const RunningTask& task : running_) {
      const auto json = read_run_progress(cache_.run(plan_.tasks[task.number]));
      if (!json.is_object() || !json.contains("done") || !json.contains("total")) continue;
      const auto &part = json.at("done"), &total = json.at("total");
      if (!part.is_number() || !total.is_number() || !(total.get<double>() > 0)) continue;
      done += std::clamp(part.get<double>() / total.get<double>(), 0.0, 1.0);
    }
    const auto percent = static_cast<int64_t>(100 * done / static_cast<double>(outcomes_.size()));
    return running_.empty() && waiting_.empty() ? 100 : std::min<int64_t>(percent, 99);
  }

  std::string note() const {
    std::string text =
        fmt::format("{} of {} stages ended, {} waiting", ended(), outcomes_.size(), waiting_.size());
    if (!taken_.empty()) {
      const StageTask& stage = plan_.tasks[*taken_.begin()];
      text += fmt::format(", {} of them for another ablation that works at {} {}", taken_.size(), stage.stage,
                          stage.key.substr(0, 6));
    }
    for (const RunningTask& task : running_) {
      const StageTask& stage = plan_.tasks[task.number];
      const std::string line = last_line(cache_.folder(stage) / "log.txt");
      text += "; " + stage.stage + " " + stage.key.substr(0, 6);
      if (!line.empty()) text += ": " + shortened(line);
    }
    return text;
  }

  // They go on next time, or are done.
  void stop_running() {
    for (RunningTask& task : running_) task.process->stop();
    while (!running_.empty()) {
      if (running_.back().process->poll()) {
        const RunningTask task = std::move(running_.back());
        running_.pop_back();
        note_end(task);
      } else {
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
      }
    }
  }

  [[noreturn]] void stop() {
    stop_running();
    const auto done =
        std::count_if(outcomes_.begin(), outcomes_.end(), [](const TaskOutcome& task) { return task.done; });
    stop_if_interrupted(
        fmt::format("the ablation stopped with {} of {} stages done; the same command goes on with it", done,
                    outcomes_.size()));
    fail({"gld ablate", "a stop that was asked for", "none", "report this"});
  }

  // Notes what becomes of a stage whose process ended.
  void note_end(const RunningTask& task) {
    const StageTask& stage = plan_.tasks[task.number];
    const FinishedProcess result = *task.process->poll();
    if (result.status == 0) {
      const StageCost cost{cache_.seconds_spent(stage) + result.seconds, result.peak_bytes,
                           size_on_disk(cache_.folder(stage))};
      cache_.finish(stage, cost);
      outcomes_[task.number].done = true;
      return;
    }
    cache_.note_seconds_spent(stage, result.seconds);
    const fs::path log = cache_.folder(stage) / "log.txt";
    const std::string how = result.status > 128 ? "signal " + std::to_string(result.status - 128)
                                                : "exit status " + std::to_string(result.status);
    outcomes_[task.number].problem = "stage '" + stage.stage + "' (" + stage.used_by.front() +
                                     ") ended with " + how + ": " + last_line(log) + " (" + log.string() +
                                     ")";
  }

  // Returns whether any ended.
  bool collect() {
    bool any = false;
    for (size_t i = 0; i < running_.size();) {
      if (!running_[i].process->poll()) {
        ++i;
        continue;
      }
      const RunningTask task = std::move(running_[i]);
      running_.erase(running_.begin() + static_cast<std::ptrdiff_t>(i));
      any = true;
      note_end(task);
      check_done(task.number);
    }
    return any;
  }

  bool alone_is_running() const {
    return std::any_of(running_.begin(), running_.end(),
                       [&](const RunningTask& task) { return plan_.tasks[task.number].alone; });
  }

  void start() {
    for (auto number = waiting_.begin(); number != waiting_.end();) {
      const StageTask& task = plan_.tasks[*number];
      const bool room = static_cast<int64_t>(running_.size()) < options_.jobs && !alone_is_running() &&
                        (!task.alone || running_.empty());
      const auto failed = std::find_if(task.needs.begin(), task.needs.end(),
                                       [&](size_t needed) { return !outcomes_[needed].problem.empty(); });
      if (failed != task.needs.end()) {
        outcomes_[*number].problem = outcomes_[*failed].problem;
        number = waiting_.erase(number);
        continue;
      }
      const bool ready = std::all_of(task.needs.begin(), task.needs.end(),
                                     [&](size_t needed) { return outcomes_[needed].done; });
      if (room && ready && begin(*number)) {
        number = waiting_.erase(number);
      } else {
        ++number;
      }
    }
  }

  // Returns false where another ablation works at the stage.
  bool begin(size_t number) {
    const StageTask& task = plan_.tasks[number];
    RunningTask running;
    running.number = number;
    try {
      fs::create_directories(cache_.folder(task));
      running.lock = std::make_unique<StageLock>(cache_.folder(task));
      if (!running.lock->take()) {
        taken_.insert(number);
        return false;
      }
    } catch (const Error& error) {
      outcomes_[number].problem = problem_text(task, error);
      return true;
    }
    taken_.erase(number);
    if (cache_.state(task) == StageState::kDone) {  // by the other one, meanwhile
      outcomes_[number].done = true;
      check_done(number);
      return true;
    }
    try {
      require_same_base(task);
      remove_abandoned_files(cache_.folder(task));
      cache_.begin(task);
      if (task.command == kAssembleCommand) {
        assemble(task);
        outcomes_[number].done = true;
        return true;
      }
      const bool resume = prepare_run(task);
      write_file_atomically(cache_.folder(task) / "options.yaml",
                            with_folders(task.options, task, plan_, cache_));
      running.process = std::make_unique<ChildProcess>(command_line_of(task, plan_, cache_, options_, resume),
                                                       cache_.folder(task) / "log.txt", running.lock->file());
    } catch (const Error& error) {
      outcomes_[number].problem = problem_text(task, error);
      return true;
    }
    running_.push_back(std::move(running));
    return true;
  }

  static std::string problem_text(const StageTask& task, const Error& error) {
    return "stage '" + task.stage + "' (" + task.used_by.front() + "): " + error.what();
  }

  // A result of other weights would be kept under the key of those that the ablation was planned with.
  static void require_same_base(const StageTask& task) {
    if (!task.takes_model || task.model || files_stamp(task.base_model) == task.base_stamp) return;
    if (ModelBundle::open(task.base_model).content_hash() == task.base_hash) return;
    fail({task.base_model.string(), "the files that the ablation began with", "others",
          "put them back, or run the command again"});
  }

  void assemble(const StageTask& task) const {
    const auto start = std::chrono::steady_clock::now();
    fs::remove_all(cache_.run(task));  // what an end in the midst of it left
    std::vector<fs::path> others;
    for (const size_t part : task.parts) others.push_back(cache_.model(plan_.tasks[part]));
    fs::create_directories(cache_.run(task));
    assemble_bundle(*task.bundle, model_folder(task, plan_, cache_), others, cache_.model(task));
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    cache_.finish(task, {seconds.count(), 0, size_on_disk(cache_.folder(task))});
  }

  // Commands refuse to go on with other options than they were begun with, and the cache may be named otherwise now.
  // Trainings may go on with a model of another name.
  bool is_of_these_folders(const StageTask& task, const fs::path& run) const {
    const fs::path options = cache_.folder(task) / "options.yaml", configuration = run / "config.yaml";
    if (!fs::exists(options) || read_file(options) != with_folders(task.options, task, plan_, cache_))
      return false;
    if (!task.takes_model || trains(task.command) || !fs::exists(configuration)) return true;
    const auto model = parse_yaml(read_file(configuration), configuration.string())["model"];
    return model && model.IsScalar() && model.Scalar() == model_folder(task, plan_, cache_).string();
  }

  // Leaves the run folder as the command can begin or go on in it; returns whether it goes on.
  bool prepare_run(const StageTask& task) const {
    const fs::path run = cache_.run(task);
    if (task.resumed && !fs::exists(run)) branch_training(cache_.run(plan_.tasks[*task.resumed]), run);
    if (!fs::exists(run)) return false;
    if (task.resumable && is_of_these_folders(task, run) &&
        (!trains(task.command) || has_training_checkpoint(run)))
      return true;
    fs::remove_all(run);
    if (!task.resumed) return false;
    branch_training(cache_.run(plan_.tasks[*task.resumed]), run);
    return true;
  }

  const AblationPlan& plan_;
  const StageCache& cache_;
  const RunningOptions& options_;
  std::vector<TaskOutcome> outcomes_;
  std::vector<size_t> waiting_;
  std::set<size_t> taken_;  // of the waiting ones, those that another ablation works at
  std::vector<RunningTask> running_;
};

}  // namespace

std::vector<std::string> command_line_of(const StageTask& task, const AblationPlan& plan,
                                         const StageCache& cache, const RunningOptions& options,
                                         bool resume) {
  std::vector<std::string> line{options.program.string()};
  std::istringstream words(task.command);
  for (std::string word; words >> word;) line.push_back(word);
  line.insert(line.end(), {"--config", (cache.folder(task) / "options.yaml").string()});
  if (task.takes_model) line.insert(line.end(), {"--model", model_folder(task, plan, cache).string()});
  line.insert(line.end(), {"--out", cache.run(task).string()});
  if (task.takes_threads) line.insert(line.end(), {"--threads", std::to_string(options.threads)});
  if (task.takes_kept_scenes) line.insert(line.end(), {"--kept-scenes", cache.kept_scenes().string()});
  if (resume) line.emplace_back("--resume");
  return line;
}

std::vector<TaskOutcome> run_tasks(const AblationPlan& plan, const StageCache& cache,
                                   const RunningOptions& options) {
  return Scheduler(plan, cache, options).run();
}

}  // namespace gld
