#include "infer/forecast/machine_rates.h"

#include "gld/base/atomic_file.h"
#include "gld/base/user_cache.h"
#include "gld/machine/timing.h"
#include "models/dit/dit_options.h"
#include "tests/support/temporary_folder.h"

#include <cstdlib>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

RateKey some_key() { return {"host", "processor", 2, "gld 0.1.0"}; }

MachineSpeed some_speed(double linear) {
  MachineSpeed speed;
  speed.multiply_add_peak = speed.matrix_product = speed.attention = speed.loading = 1e9;
  speed.linear = linear;
  speed.small_model = 2;
  speed.large_model = 1.1;
  return speed;
}

// The environment's cache folder for as long as it lives.
class CacheVariables {
 public:
  CacheVariables(const char* cache, const char* home) : cache_(of("XDG_CACHE_HOME")), home_(of("HOME")) {
    set("XDG_CACHE_HOME", cache);
    set("HOME", home);
  }
  ~CacheVariables() {
    set("XDG_CACHE_HOME", cache_.empty() ? nullptr : cache_.c_str());
    set("HOME", home_.empty() ? nullptr : home_.c_str());
  }
  CacheVariables(const CacheVariables&) = delete;
  CacheVariables& operator=(const CacheVariables&) = delete;

 private:
  static std::string of(const char* name) {
    const char* value = std::getenv(name);
    return value == nullptr ? "" : value;
  }
  static void set(const char* name, const char* value) {
    if (value == nullptr) {
      ::unsetenv(name);
    } else {
      ::setenv(name, value, 1);
    }
  }
  std::string cache_, home_;
};

TEST(MachineRates, AreKeptByMachineThreadsAndProgram) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "new" / "machine_rates.json";
  EXPECT_FALSE(kept_machine_speed(file, some_key()));
  auto more_threads = some_key();
  more_threads.threads = 4;
  keep_machine_speed(file, some_key(), some_speed(5e9));
  keep_machine_speed(file, more_threads, some_speed(9e9));
  keep_machine_speed(file, some_key(), some_speed(6e9));
  EXPECT_EQ(kept_machine_speed(file, some_key())->linear, 6e9);
  EXPECT_EQ(kept_machine_speed(file, some_key())->large_model, 1.1);
  EXPECT_EQ(kept_machine_speed(file, more_threads)->linear, 9e9);
  auto other_program = some_key();
  other_program.program = "gld 0.2.0";
  EXPECT_FALSE(kept_machine_speed(file, other_program));
}

TEST(MachineRates, ADamagedFileCountsForNothingAndIsReplaced) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "machine_rates.json";
  for (const char* text : {"", "{", "[1]", "{\"rates\": 3}", "{\"rates\": [{\"of\": 1}, 2]}"}) {
    write_file_atomically(file, text);
    EXPECT_FALSE(kept_machine_speed(file, some_key())) << text;
  }
  keep_machine_speed(file, some_key(), some_speed(5e9));
  EXPECT_EQ(kept_machine_speed(file, some_key())->linear, 5e9);
  // A rate that is no speed.
  keep_machine_speed(file, some_key(), some_speed(0));
  EXPECT_FALSE(kept_machine_speed(file, some_key()));
}

TEST(MachineRates, LieInTheUsersCacheFolder) {
  {
    const CacheVariables variables("/caches", "/home/user");
    EXPECT_EQ(machine_rates_file(), "/caches/gld/machine_rates.json");
  }
  {
    const CacheVariables variables("relative", "/home/user");
    EXPECT_EQ(machine_rates_file(), "/home/user/.cache/gld/machine_rates.json");
  }
  const CacheVariables variables(nullptr, nullptr);
  EXPECT_EQ(user_cache_folder(), "");
  EXPECT_EQ(machine_rates_file(), "");
  EXPECT_THAT(known_machine_speed().origin, testing::HasSubstr("quick estimate"));
}

TEST(MachineRates, TheQuickEstimateIsQuick) {
  const double seconds = seconds_of([] {
    const MachineSpeed speed = estimate_machine_speed();
    EXPECT_GT(speed.linear, 0);
    EXPECT_GT(speed.attention, 0);
    EXPECT_GT(speed.loading, 0);
  });
  EXPECT_LT(seconds,
            2);  // 0.1 s alone on two cores; other programs may hold it up, a loop would not end here
}

TEST(MachineRates, ModelsPayForMoreThanTheirProducts) {
  const MachineSpeed speed = some_speed(1e9);
  Cost tiny, huge;
  tiny.linear_flop = 1e6;
  huge.linear_flop = 1e13;
  EXPECT_NEAR(model_seconds(tiny, 1, speed), 2 * 1e-3, 1e-9);
  EXPECT_NEAR(model_seconds(huge, 1, speed), 1.1 * 1e4, 1e-3);
  // A pass decides, not the sum of many.
  EXPECT_NEAR(model_seconds(huge, 1e7, speed), 2 * 1e4, 1e-3);
}

}  // namespace
}  // namespace gld
