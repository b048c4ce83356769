#include "train/loop/checkpoint_on_stop.h"

#include "gld/base/interrupt.h"
#include "gld/base/interrupted_end.h"
#include "gld/report/run_folder.h"

#include <chrono>
#include <exception>
#include <string>
#include <utility>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

using Clock = std::chrono::steady_clock;

constexpr auto kBetweenLooks = std::chrono::milliseconds(50);
// This much time is left to the loop's own safe point, which loses nothing.
constexpr auto kGrace = std::chrono::milliseconds(500);

}  // namespace

std::string stopped_text(const std::filesystem::path& run, int64_t step,
                         const std::filesystem::path& checkpoint) {
  return fmt::format("training stopped after step {}, kept in {}; {}", step, checkpoint.string(),
                     command_of_run(run).empty() ? "the same command with --resume goes on"
                                                 : "go on with: " + resume_command(run));
}

CheckpointOnStop::CheckpointOnStop(const CheckpointFolder& folder, std::function<void()> stopped)
    : folder_(folder), stopped_(std::move(stopped)), watcher_([this] { watch(); }) {}

CheckpointOnStop::~CheckpointOnStop() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    ended_ = true;
  }
  changed_.notify_all();
  watcher_.join();
}

CheckpointOnStop::Steady::Steady(CheckpointOnStop& owner, Checkpoint state) : owner_(owner) {
  const std::lock_guard<std::mutex> lock(owner_.mutex_);
  owner_.state_ = std::move(state);
}

CheckpointOnStop::Steady::~Steady() {
  const std::lock_guard<std::mutex> lock(owner_.mutex_);
  owner_.state_.reset();
}

void CheckpointOnStop::watch() {
  std::unique_lock<std::mutex> lock(mutex_);
  std::optional<Clock::time_point> asked;
  while (!ended_) {
    changed_.wait_for(lock, kBetweenLooks, [this] { return ended_; });
    if (ended_ || !interrupt_requested()) continue;
    if (!asked) asked = Clock::now();
    if (!state_ || Clock::now() - *asked < kGrace) continue;
    std::string done;
    try {
      const torch::NoGradGuard no_grad;
      const auto file = folder_.save(*state_);
      done = stopped_text(folder_.path().parent_path(), state_->step, file);
    } catch (const std::exception& error) {
      done = "training stopped after step " + std::to_string(state_->step) +
             "; its checkpoint was not written: " + error.what();
    }
    if (stopped_) stopped_();
    end_interrupted_process(done);
  }
}

}  // namespace gld
