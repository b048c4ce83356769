#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

namespace gld {

// What is on its way.
struct ProgressOf {
  std::string stage;
  int64_t steps = 0;        // 0 where their number is not known
  int64_t done_before = 0;  // of them, by an interrupted run that this one goes on with
  // The folder whose progress.json says the same to other programs: stage, done, total (null: not known), seconds_left
  // (null: not known yet) and note. It is written at most once a second, less often in long runs (every half a minute
  // after the first hour), and stays behind as it was last; where it cannot be written the run goes on without. Empty:
  // no such file.
  std::filesystem::path run;
};

// A line on standard error with stage, step, rate and remaining time: redrawn in place on a terminal, plain
// lines (at most one every few seconds, and the last) elsewhere.
class Progress {
 public:
  explicit Progress(ProgressOf what);
  Progress(std::string stage, int64_t steps) : Progress(ProgressOf{std::move(stage), steps, 0, {}}) {}
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // done is the steps so far, those of before included; note is shown behind the rate ("t 0.43", "loss 0.12").
  void update(int64_t done, const std::string& note = "");
  void finish();

 private:
  void draw(bool last);
  void write(bool last);
  double steps_a_second() const;  // 0 where nothing is done yet

  ProgressOf what_;
  int64_t done_;
  std::string note_;
  bool terminal_;
  bool finished_ = false;
  std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point drawn_;
  std::chrono::steady_clock::time_point written_;
};

// Writes into progress.json of a run that a stage of unknown length begins.
void note_stage(const std::filesystem::path& run, const std::string& stage);

// Returns what progress.json of a run says last, and null where there is none, or no JSON object.
nlohmann::ordered_json read_run_progress(const std::filesystem::path& run);

// Whether progress is shown at all, which it is until this says otherwise. The terminal is one for the whole process.
void show_progress(bool shown);

// Returns "1 h 02 min", "3 min 20 s" or "4.2 s", for example.
std::string duration_text(double seconds);

}  // namespace gld
