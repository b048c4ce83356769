#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace gld {

// A line on standard error with stage, step, rate and remaining time: redrawn in place on a terminal, plain
// lines (at most one every few seconds, and the last) elsewhere.
class Progress {
 public:
  // steps: 0 where their number is not known.
  Progress(std::string stage, int64_t steps);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // done steps so far; note is shown behind the rate ("t 0.43", "loss 0.12").
  void update(int64_t done, const std::string& note = "");
  void finish();

 private:
  void draw(bool last);

  std::string stage_;
  int64_t steps_;
  int64_t done_ = 0;
  std::string note_;
  bool terminal_;
  bool finished_ = false;
  std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point drawn_;
};

// Whether progress is shown at all, which it is until this says otherwise. The terminal is one for the whole process.
void show_progress(bool shown);

// "1 h 02 min", "3 min 20 s", "4.2 s".
std::string duration_text(double seconds);

}  // namespace gld
