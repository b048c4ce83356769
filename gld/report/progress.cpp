#include "gld/report/progress.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/run_journal.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>

#include <fmt/format.h>
#include <unistd.h>

namespace gld {
namespace {

using Clock = std::chrono::steady_clock;

std::atomic<bool> progress_is_shown{true};

double seconds_between(Clock::time_point from, Clock::time_point to) {
  return std::chrono::duration<double>(to - from).count();
}

nlohmann::ordered_json progress_json(const std::string& stage) {
  return {{"stage", stage}, {"done", 0}, {"total", nullptr}, {"seconds_left", nullptr}, {"note", ""}};
}

// Returns whether it could be written: a disk that is full refuses the results too, and they say so.
bool write_progress_file(const std::filesystem::path& run, const nlohmann::ordered_json& json) {
  try {
    write_file_atomically(run / kRunProgress, json_text(json, 2) + "\n");
    return true;
  } catch (const Error&) {
    return false;
  }
}

}  // namespace

void show_progress(bool shown) { progress_is_shown = shown; }

std::string duration_text(double seconds) {
  if (seconds < 10) return fmt::format("{:.1f} s", seconds);
  const auto whole = static_cast<int64_t>(std::llround(seconds));
  if (whole < 60) return fmt::format("{} s", whole);
  if (whole < 3600) return fmt::format("{} min {:02} s", whole / 60, whole % 60);
  return fmt::format("{} h {:02} min", whole / 3600, whole % 3600 / 60);
}

Progress::Progress(ProgressOf what)
    : what_(std::move(what)),
      done_(what_.done_before),
      terminal_(::isatty(STDERR_FILENO) == 1),
      start_(Clock::now()),
      drawn_(start_),
      written_(start_) {
  if (terminal_) draw(false);
  write(false);
}

Progress::~Progress() {
  if (!finished_ && terminal_ && progress_is_shown) std::fputc('\n', stderr);
}

void Progress::update(int64_t done, const std::string& note) {
  done_ = done;
  note_ = note;
  const auto now = Clock::now();
  if (seconds_between(drawn_, now) >= (terminal_ ? 0.1 : 10.0)) draw(false);
  const double interval = std::clamp(seconds_between(start_, now) / 120, 1.0, 30.0);
  if (seconds_between(written_, now) >= interval) write(false);
}

void Progress::finish() {
  if (finished_) return;
  finished_ = true;
  draw(true);
  write(true);
}

double Progress::steps_a_second() const {
  const double elapsed = seconds_between(start_, Clock::now());
  return elapsed > 0 ? static_cast<double>(done_ - what_.done_before) / elapsed : 0;
}

void Progress::draw(bool last) {
  drawn_ = Clock::now();
  if (!progress_is_shown) return;
  std::string line = what_.steps > 0 ? fmt::format("{:<18} {:>4}/{}", what_.stage, done_, what_.steps)
                                     : fmt::format("{:<18} {:>4}", what_.stage, done_);
  if (const double rate = steps_a_second(); rate > 0) {
    line += rate >= 1 ? fmt::format("  {:.1f}/s", rate) : fmt::format("  {:.1f} s each", 1 / rate);
    if (last) {
      line += "  " + duration_text(seconds_between(start_, drawn_));
    } else if (what_.steps > 0) {
      line += "  " + duration_text(static_cast<double>(what_.steps - done_) / rate) + " left";
    }
  }
  if (!note_.empty()) line += "  " + note_;
  std::fputs((terminal_ ? "\r\033[K" + line + (last ? "\n" : "") : line + "\n").c_str(), stderr);
  std::fflush(stderr);
}

void Progress::write(bool last) {
  written_ = Clock::now();
  if (what_.run.empty()) return;
  auto json = progress_json(what_.stage);
  json["done"] = done_;
  if (what_.steps > 0) json["total"] = what_.steps;
  const double rate = steps_a_second();
  if (last) {
    json["seconds_left"] = 0;
  } else if (rate > 0 && what_.steps > 0) {
    json["seconds_left"] = std::llround(static_cast<double>(what_.steps - done_) / rate);
  }
  if (!last) json["note"] = note_;  // of what was done last, which is not the same with several processes
  if (!write_progress_file(what_.run, json)) what_.run.clear();
}

void note_stage(const std::filesystem::path& run, const std::string& stage) {
  write_progress_file(run, progress_json(stage));
}

nlohmann::ordered_json read_run_progress(const std::filesystem::path& run) {
  try {
    const auto file = run / kRunProgress;
    auto json = parse_ordered_json(read_file(file, 1 << 20), file.string());
    if (json.is_object()) return json;
  } catch (const Error&) {
    // None, or damaged: how far a run is matters to nobody but who looks.
  }
  return nullptr;
}

}  // namespace gld
