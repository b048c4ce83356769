#include "gld/flow/schedule.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <fmt/format.h>

namespace gld {
namespace {

std::vector<double> uniform_times(int64_t steps, double last) {
  std::vector<double> times;
  times.reserve(static_cast<size_t>(steps) + 1);
  for (int64_t i = 0; i <= steps; ++i) {
    times.push_back(1.0 - (1.0 - last) * static_cast<double>(i) / static_cast<double>(steps));
  }
  times.back() = last;
  return times;
}

void shift_all(std::vector<double>& times, double shift) {
  if (!(shift > 0)) {
    fail({"shift", "a time shift above 0", fmt::format("{}", shift),
          "name one; 0 needs a model that has one"});
  }
  for (double& time : times) time = shifted_time(time, shift);
}

LogSnrEndPoints chosen_end_points(const ScheduleOptions& options, int64_t steps) {
  LogSnrEndPoints ends = log_snr_end_points(steps);
  if (options.first_time > 0) ends.first_time = options.first_time;
  if (options.final_time > 0) ends.final_time = options.final_time;
  if (ends.final_time >= ends.first_time) {
    fail({"schedule", fmt::format("final_time below first_time {}", ends.first_time),
          fmt::format("{}", ends.final_time), "lower final_time or raise first_time"});
  }
  return ends;
}

// Returns 1, a row of inner times whose ends are given, and 0. inner(x) maps 0..1 to a time.
template <class Inner>
std::vector<double> enclosed_times(int64_t steps, const Inner& inner) {
  std::vector<double> times{1.0};
  const int64_t count = steps - 1;
  for (int64_t i = 0; i < count; ++i) {
    times.push_back(inner(count == 1 ? 0.5 : static_cast<double>(i) / static_cast<double>(count - 1)));
  }
  times.push_back(0.0);
  return times;
}

std::vector<double> log_snr_times(const ScheduleOptions& options, int64_t steps) {
  const LogSnrEndPoints ends = chosen_end_points(options, steps);
  const auto log_snr = [](double t) { return std::log((1 - t) / t); };
  const double first = log_snr(ends.first_time), last = log_snr(ends.final_time);
  return enclosed_times(steps, [&](double x) { return 1.0 / (1.0 + std::exp(first + x * (last - first))); });
}

std::vector<double> karras_times(const ScheduleOptions& options, int64_t steps) {
  constexpr double kRho = 7;
  const LogSnrEndPoints ends = chosen_end_points(options, steps);
  const auto root = [](double t) { return std::pow(t / (1 - t), 1 / kRho); };
  const double first = root(ends.first_time), last = root(ends.final_time);
  return enclosed_times(steps, [&](double x) {
    const double sigma = std::pow(first + x * (last - first), kRho);
    return sigma / (1 + sigma);
  });
}

void check_end(const std::vector<double>& times, const std::string& where) {
  // Beyond this a state is more noise than data: x = (1 - t) data + t noise.
  constexpr double kLatestEnd = 0.5;
  if (times.back() <= kLatestEnd) return;
  fail({where, fmt::format("times that end at 0, or near it (at most {})", kLatestEnd),
        fmt::format("{}", times.back()), "go on with the times down to 0, or the images are noise"});
}

std::vector<double> times_of_file(const std::string& file) {
  constexpr uint64_t kLimit = uint64_t{1} << 24;
  std::string text = read_file(file, kLimit);
  for (size_t begin = text.find('#'); begin != std::string::npos; begin = text.find('#', begin)) {
    const size_t end = std::min(text.find('\n', begin), text.size());
    text.replace(begin, end - begin, " ");
  }
  std::replace(text.begin(), text.end(), ',', ' ');
  std::vector<double> times;
  for (size_t at = text.find_first_not_of(" \t\r\n"); at != std::string::npos;
       at = text.find_first_not_of(" \t\r\n", at)) {
    const size_t end = std::min(text.find_first_of(" \t\r\n", at), text.size());
    const std::string word = text.substr(at, end - at);
    char* rest = nullptr;
    times.push_back(std::strtod(word.c_str(), &rest));
    if (*rest != '\0') {
      fail({file, "numbers separated by blanks, commas or lines", "\"" + word.substr(0, 40) + "\"",
            "write the times from 1 down to 0, with '#' before comments"});
    }
    at = end;
  }
  check_times(times, file);
  // What a solve begins with is noise alone.
  if (times.front() != 1) {
    fail({file, "times that begin at 1, where there is noise alone", fmt::format("{}", times.front()),
          "begin with 1"});
  }
  check_end(times, file);
  return times;
}

}  // namespace

const std::vector<std::string>& schedule_names() {
  static const std::vector<std::string> names{"published", "uniform", "shifted", "logsnr", "karras", "file"};
  return names;
}

void ScheduleOptions::visit(FieldVisitor& visitor) {
  visit_choice(visitor, {"schedule", "how flow time runs from noise (1) to data (0)"}, schedule,
               schedule_names());
  visitor.real({"shift", "time shift of the schedules published and shifted; 0: the model's"}, shift,
               {0, 1e6});
  visitor.real({"last_time", "end of the published grid before it is shifted"}, last_time, {0, 0.999});
  visitor.real({"first_time", "first time below 1 of logsnr and karras; 0 for the rule"}, first_time,
               {0, 1 - 1e-9});
  visitor.real({"final_time", "last time above 0 of logsnr and karras; 0 for the rule"}, final_time,
               {0, 0.999});
  visitor.text({"schedule_file", "text file with the times of schedule file"}, schedule_file);
}

void ScheduleOptions::check() const {
  if (schedule == ScheduleKind::kFile && schedule_file.empty()) {
    fail({"schedule_file", "a file of times for schedule file", "nothing",
          "name a file or choose another schedule"});
  }
}

double shifted_time(double time, double shift) {
  // s t / (1 + (s - 1) t), in the form that is 0 and 1 at the ends for every s > 0, small ones too.
  return shift * time / (shift * time + (1 - time));
}

LogSnrEndPoints log_snr_end_points(int64_t steps) {
  const double n = static_cast<double>(std::max<int64_t>(steps, 2));
  return {1 - 0.04 / n - 10.8 / (n * n * n * n), std::min(0.022, 2.6 / (n * n))};
}

std::vector<double> schedule_times(const ScheduleOptions& options, int64_t steps) {
  if (options.schedule == ScheduleKind::kFile) return times_of_file(options.schedule_file);
  if (steps < 1) {
    fail({"schedule", "at least 1 step", std::to_string(steps), "ask for at least one function evaluation"});
  }
  std::vector<double> times;
  switch (options.schedule) {
    case ScheduleKind::kPublished:
      times = uniform_times(steps, options.last_time);
      shift_all(times, options.shift);
      break;
    case ScheduleKind::kUniform:
      times = uniform_times(steps, 0);
      break;
    case ScheduleKind::kShifted:
      times = uniform_times(steps, 0);
      shift_all(times, options.shift);
      break;
    case ScheduleKind::kLogSnr:
      times = log_snr_times(options, steps);
      break;
    case ScheduleKind::kKarras:
      times = karras_times(options, steps);
      break;
    case ScheduleKind::kFile:
      break;
  }
  check_times(times, "schedule " + schedule_names()[static_cast<size_t>(options.schedule)]);
  return times;
}

void check_times(const std::vector<double>& times, const std::string& where) {
  if (times.size() < 2) {
    fail({where, "at least two times", std::to_string(times.size()), "list the start and the end as well"});
  }
  for (size_t i = 0; i < times.size(); ++i) {
    if (!(times[i] >= 0 && times[i] <= 1)) {
      fail({where, "flow times between 0 and 1", fmt::format("{} at place {}", times[i], i + 1),
            "1 is noise and 0 is data"});
    }
    if (i > 0 && times[i] >= times[i - 1]) {
      fail({where, "strictly decreasing times",
            fmt::format("{} after {} at place {}", times[i], times[i - 1], i + 1),
            "sort them from 1 down to 0"});
    }
  }
}

}  // namespace gld
