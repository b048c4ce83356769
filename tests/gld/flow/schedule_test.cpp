#include "gld/flow/schedule.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

ScheduleOptions schedule_of(ScheduleKind kind) {
  ScheduleOptions options;
  options.schedule = kind;
  return options;
}

// The released sampler takes 50 points, so 49 steps, and stops at 0.030 with shift 31.18 (DESIGN.md section 4).
TEST(Schedule, PublishedGridStopsAboveZero) {
  auto options = schedule_of(ScheduleKind::kPublished);
  const auto times = schedule_times(options, 49);
  ASSERT_EQ(times.size(), 50u);
  EXPECT_EQ(times.front(), 1);
  EXPECT_NEAR(times[48], 0.405, 5e-4);
  EXPECT_NEAR(times[49], 0.030, 5e-4);
  // The times are s u / (1 + (s - 1) u) at u = 1 - 0.999 * 48/49 and u = 0.001; DESIGN.md section 4, "Flow" rounds them
  // to 0.58 and 0.059.
  options.shift = 62.4;
  EXPECT_NEAR(schedule_times(options, 49)[48], 0.57695, 1e-5);
  EXPECT_NEAR(schedule_times(options, 49)[49], 0.05879, 1e-5);
}

// The times of the reference case sample_level1, as printed by the published implementation in float32.
TEST(Schedule, PublishedGridEqualsTheReference) {
  auto options = schedule_of(ScheduleKind::kPublished);
  options.shift = 18;
  const auto times = schedule_times(options, 5);
  const double expected[] = {1, 0.9863182902, 0.9643430710, 0.9232541919, 0.8189232945, 0.0176988915};
  ASSERT_EQ(times.size(), 6u);
  for (size_t i = 0; i < times.size(); ++i) EXPECT_NEAR(times[i], expected[i], 1e-6);
}

// With every schedule, every number of steps and every shift they are strictly decreasing from 1, and to 0 except for
// published.
TEST(Schedule, AllAreDecreasingForOneToAThousandSteps) {
  for (const ScheduleKind kind : {ScheduleKind::kPublished, ScheduleKind::kUniform, ScheduleKind::kShifted,
                                  ScheduleKind::kLogSnr, ScheduleKind::kKarras}) {
    for (const double shift : {1.0, 3.0, 31.18, 62.4, 100.0}) {
      auto options = schedule_of(kind);
      options.shift = shift;
      for (int64_t steps = 1; steps <= 1000; steps = steps < 20 ? steps + 1 : steps * 7 / 5) {
        const auto times = schedule_times(options, steps);
        ASSERT_EQ(times.size(), static_cast<size_t>(steps) + 1);
        EXPECT_EQ(times.front(), 1);
        if (kind == ScheduleKind::kPublished) {
          EXPECT_GT(times.back(), 0);
        } else {
          EXPECT_EQ(times.back(), 0);
        }
        for (size_t i = 1; i < times.size(); ++i) ASSERT_LT(times[i], times[i - 1]) << steps << " " << shift;
      }
      EXPECT_EQ(schedule_times(options, 1000).size(), 1001u);
    }
  }
}

TEST(Schedule, LogSnrIsEquallySpacedBetweenTheRulesEnds) {
  const auto times = schedule_times(schedule_of(ScheduleKind::kLogSnr), 16);
  const auto ends = log_snr_end_points(16);
  EXPECT_NEAR(times[1], ends.first_time, 1e-12);
  EXPECT_NEAR(times[15], ends.final_time, 1e-12);
  EXPECT_NEAR(ends.first_time, 1 - 0.04 / 16 - 10.8 / 65536, 1e-12);
  EXPECT_NEAR(ends.final_time, 2.6 / 256, 1e-12);
  const auto log_snr = [&](size_t i) { return std::log((1 - times[i]) / times[i]); };
  for (size_t i = 2; i < 15; ++i) EXPECT_NEAR(log_snr(i + 1) - log_snr(i), log_snr(i) - log_snr(i - 1), 1e-9);
  // The ends move out with the number of steps, so that neither becomes the floor of the error.
  for (int64_t steps = 3; steps < 2000; ++steps) {
    EXPECT_GT(log_snr_end_points(steps).first_time, log_snr_end_points(steps - 1).first_time);
    EXPECT_LE(log_snr_end_points(steps).final_time, log_snr_end_points(steps - 1).final_time);
  }
}

TEST(Schedule, KarrasMatchesItsFormula) {
  const auto times = schedule_times(schedule_of(ScheduleKind::kKarras), 8);
  const auto ends = log_snr_end_points(8);
  const auto sigma = [](double t) { return t / (1 - t); };
  const double low = std::pow(sigma(ends.final_time), 1 / 7.0),
               high = std::pow(sigma(ends.first_time), 1 / 7.0);
  for (size_t i = 0; i < 7; ++i) {
    const double expected = std::pow(high + static_cast<double>(i) / 6 * (low - high), 7);
    EXPECT_NEAR(sigma(times[i + 1]) / expected, 1, 1e-9);
  }
}

TEST(Schedule, ShiftKeepsTheEnds) {
  for (const double shift : {1.0, 7.0, 100.0}) {
    EXPECT_EQ(shifted_time(0, shift), 0);
    EXPECT_EQ(shifted_time(1, shift), 1);
  }
  EXPECT_DOUBLE_EQ(shifted_time(0.5, 3), 0.75);
}

TEST(Schedule, ReadsAFileOfTimes) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "times.txt";
  write_file_atomically(file, "# start\n1, 0.9 0.5\n0.25 # late\n0\n");
  auto options = schedule_of(ScheduleKind::kFile);
  options.schedule_file = file.string();
  EXPECT_THAT(schedule_times(options, 99), testing::ElementsAre(1, 0.9, 0.5, 0.25, 0));
}

TEST(Schedule, RefusesBadInputInOneSentence) {
  const test::TemporaryFolder folder;
  const auto file = (folder.path() / "times.txt").string();
  auto options = schedule_of(ScheduleKind::kFile);
  options.schedule_file = file;
  const auto error_with = [&](const std::string& text) {
    write_file_atomically(file, text);
    return error_of([&] { schedule_times(options, 4); });
  };
  EXPECT_EQ(error_with("1 0.5 x 0"),
            file +
                ": expected numbers separated by blanks, commas or lines, found \"x\"; "
                "write the times from 1 down to 0, with '#' before comments.");
  EXPECT_EQ(
      error_with("1 0.9"),
      file +
          ": expected times that end at 0, or near it (at most 0.5), found 0.9; go on with the times down to "
          "0, or the images are noise.");
  EXPECT_EQ(error_with("1"),
            file + ": expected at least two times, found 1; list the start and the end as well.");
  EXPECT_EQ(error_with("1 0.5 0.5"), file +
                                         ": expected strictly decreasing times, "
                                         "found 0.5 after 0.5 at place 3; sort them from 1 down to 0.");
  EXPECT_EQ(error_with("1.5 0.5"),
            file + ": expected flow times between 0 and 1, found 1.5 at place 1; 1 is noise and 0 is data.");
  EXPECT_EQ(error_with("1 nan"),
            file + ": expected flow times between 0 and 1, found nan at place 2; 1 is noise and 0 is data.");
  EXPECT_EQ(error_of([] { schedule_times(schedule_of(ScheduleKind::kUniform), 0); }),
            "schedule: expected at least 1 step, found 0; ask for at least one function evaluation.");
  EXPECT_EQ(error_of([] { schedule_of(ScheduleKind::kFile).check(); }),
            "schedule_file: expected a file of times for schedule file, found nothing; "
            "name a file or choose another schedule.");
  auto ends = schedule_of(ScheduleKind::kLogSnr);
  ends.first_time = 0.5;
  ends.final_time = 0.6;
  EXPECT_EQ(
      error_of([&] { schedule_times(ends, 4); }),
      "schedule: expected final_time below first_time 0.5, found 0.6; lower final_time or raise first_time.");
  auto shift = schedule_of(ScheduleKind::kPublished);
  shift.shift = 0;
  EXPECT_EQ(error_of([&] { schedule_times(shift, 4); }),
            "shift: expected a time shift above 0, found 0; name one; 0 needs a model that has one.");
}

}  // namespace
}  // namespace gld
