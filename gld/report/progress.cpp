#include "gld/report/progress.h"

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

}  // namespace

void show_progress(bool shown) { progress_is_shown = shown; }

std::string duration_text(double seconds) {
  if (seconds < 10) return fmt::format("{:.1f} s", seconds);
  const auto whole = static_cast<int64_t>(std::llround(seconds));
  if (whole < 60) return fmt::format("{} s", whole);
  if (whole < 3600) return fmt::format("{} min {:02} s", whole / 60, whole % 60);
  return fmt::format("{} h {:02} min", whole / 3600, whole % 3600 / 60);
}

Progress::Progress(std::string stage, int64_t steps)
    : stage_(std::move(stage)),
      steps_(steps),
      terminal_(::isatty(STDERR_FILENO) == 1),
      start_(Clock::now()),
      drawn_(start_) {
  if (terminal_) draw(false);
}

Progress::~Progress() {
  if (!finished_ && terminal_ && progress_is_shown) std::fputc('\n', stderr);
}

void Progress::update(int64_t done, const std::string& note) {
  done_ = done;
  note_ = note;
  const double interval = terminal_ ? 0.1 : 10.0;
  if (seconds_between(drawn_, Clock::now()) >= interval) draw(false);
}

void Progress::finish() {
  if (finished_) return;
  finished_ = true;
  draw(true);
}

void Progress::draw(bool last) {
  drawn_ = Clock::now();
  if (!progress_is_shown) return;
  const double elapsed = seconds_between(start_, drawn_);
  std::string line = steps_ > 0 ? fmt::format("{:<18} {:>4}/{}", stage_, done_, steps_)
                                : fmt::format("{:<18} {:>4}", stage_, done_);
  if (done_ > 0 && elapsed > 0) {
    const double rate = static_cast<double>(done_) / elapsed;
    line += rate >= 1 ? fmt::format("  {:.1f}/s", rate) : fmt::format("  {:.1f} s each", 1 / rate);
    if (last) {
      line += "  " + duration_text(elapsed);
    } else if (steps_ > 0) {
      line += "  " + duration_text(static_cast<double>(steps_ - done_) / rate) + " left";
    }
  }
  if (!note_.empty()) line += "  " + note_;
  std::fputs((terminal_ ? "\r\033[K" + line + (last ? "\n" : "") : line + "\n").c_str(), stderr);
  std::fflush(stderr);
}

}  // namespace gld
