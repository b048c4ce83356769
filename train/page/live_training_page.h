#pragma once

#include "train/page/training_page.h"

#include <chrono>
#include <filesystem>

namespace gld {

// Keeps report.html of a run of gld train as the run goes: at the first call of follow() and then every
// kTrainingPageSeconds; that of the finished run with end(); without it, that of a stopped one when this object goes.
// Where it cannot be written the training goes on without.
class LiveTrainingPage {
 public:
  explicit LiveTrainingPage(std::filesystem::path run) : run_(std::move(run)) {}
  ~LiveTrainingPage();
  LiveTrainingPage(const LiveTrainingPage&) = delete;
  LiveTrainingPage& operator=(const LiveTrainingPage&) = delete;

  // A step is done: slow ones are followed as often as fast ones.
  void follow();
  // The training is stopped, and this object's end will not come. Does not throw.
  void stop() noexcept;
  // report.json is written. Throws Error where the page cannot be.
  void end();

 private:
  std::filesystem::path run_;
  bool ended_ = false;
  bool written_ = false;
  std::chrono::steady_clock::time_point last_;
};

}  // namespace gld
