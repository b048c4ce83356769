#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// How flow time runs from 1 (noise) towards 0 (data). A schedule is a strictly decreasing list of times; a
// one-evaluation-a-step solver with n evaluations takes n steps between n + 1 times.
//
//   published  n + 1 points from 1 to last_time on a uniform grid, each then shifted. It STOPS at a time above
//              0 (0.030 at shift 31.18): the release's sampler, whose num_times = n + 1.
//   uniform    from 1 to 0 in equal steps.
//   shifted    the uniform grid, shifted; ends at 0.
//   logsnr     1, then equally spaced in log-SNR log((1 - t)/t) from first_time to final_time, then 0. Both
//              default to the rule of log_snr_end_points().
//   karras     the same ends, spaced as sigma = t/(1 - t) of Karras et al. 2022, equation 5, with rho = 7.
//   file       the times of schedule_file: numbers separated by blanks, commas or lines; '#' starts a comment.
enum class ScheduleKind { kPublished, kUniform, kShifted, kLogSnr, kKarras, kFile };

struct ScheduleOptions : OptionsGroup {
  ScheduleKind schedule = ScheduleKind::kLogSnr;
  double shift = 31.18;
  double last_time = 0.001;
  double first_time = 0;
  double final_time = 0;
  std::string schedule_file;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

const std::vector<std::string>& schedule_names();

// Returns the steps + 1 times of a schedule, and for schedule file the file's own times, whatever steps says. Throws
// Error when steps < 1 or the file does not hold such a list.
std::vector<double> schedule_times(const ScheduleOptions& options, int64_t steps);

// t' = s t / (1 + (s - 1) t) (Esser et al. 2024, equation 23). s >= 1 moves times towards the noise end.
double shifted_time(double time, double shift);

struct LogSnrEndPoints {
  double first_time;  // the first time below 1
  double final_time;  // the last time above 0
};
// The one rule of the default grid, for any number n of steps:
//   first_time = 1 - 0.04/n - 10.8/n^4,   final_time = min(0.022, 2.6/n^2).
// With few steps the widest scales of the data are passed over in the first step and the narrowest in the last; with
// more steps both ends move out, so that neither becomes the floor of the error. Fitted with unipc3 to Gaussian
// mixtures with scales from 60 to 0.05, 6 to 32 evaluations; `gld bench solvers` measures it.
LogSnrEndPoints log_snr_end_points(int64_t steps);

// Checks a list of times: at least two, within [0, 1], strictly decreasing. where names its origin in the Error.
void check_times(const std::vector<double>& times, const std::string& where);

}  // namespace gld
