#pragma once

#include "train/loop/checkpoint.h"

#include <condition_variable>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

namespace gld {

// Returns what a run that was asked to stop says at last: its step, the checkpoint of it, and the command that goes on.
std::string stopped_text(const std::filesystem::path& run, int64_t step,
                         const std::filesystem::path& checkpoint);

// A step of a large model takes minutes: who asks a run to stop does not wait for it. While the loop is in work that
// leaves the state of the last complete step alone (Steady), a thread of its own sees that a stop was asked for
// (gld/base/interrupt.h), gives the loop half a second to come to its own safe point, and then writes that state as a
// checkpoint and ends the process. What was computed since the last complete step is lost; a resumed run computes it
// again, to the same bits.
class CheckpointOnStop {
 public:
  // stopped is called by the thread when the checkpoint is written or could not be, before the process ends; it may be
  // empty, and must not throw.
  CheckpointOnStop(const CheckpointFolder& folder, std::function<void()> stopped);
  ~CheckpointOnStop();
  CheckpointOnStop(const CheckpointOnStop&) = delete;
  CheckpointOnStop& operator=(const CheckpointOnStop&) = delete;

  // For as long as it lives, no tensor of the state may change: they are not copied. Its end waits for a checkpoint
  // that is being written, and so does not return then. There is one at a time.
  class Steady {
   public:
    Steady(CheckpointOnStop& owner, Checkpoint state);
    ~Steady();
    Steady(const Steady&) = delete;
    Steady& operator=(const Steady&) = delete;

   private:
    CheckpointOnStop& owner_;
  };

 private:
  void watch();

  const CheckpointFolder& folder_;
  std::function<void()> stopped_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<Checkpoint> state_;  // while a Steady lives
  bool ended_ = false;
  std::thread watcher_;
};

}  // namespace gld
