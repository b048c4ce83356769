#include "infer/forecast/machine_rates.h"

#include "gld/base/atomic_file.h"
#include "gld/base/user_cache.h"
#include "gld/machine/timing.h"
#include "models/dit/dit_options.h"
#include "tests/support/temporary_folder.h"

#include <cstdlib>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

RateKey some_key() { return {"host", "processor", 2, "gld 0.1.0"}; }

MachineSpeed some_speed(double linear) {
  MachineSpeed speed;
  speed.multiply_add_peak = 10e9;
  speed.matrix_product = speed.attention = speed.loading = 1e9;
  speed.linear = linear;
  speed.small_model = 2;
  speed.large_model = 1.1;
  return speed;
}

MeasuredSpeed measured(double linear) {
  MeasuredSpeed result;
  result.speed = some_speed(linear);
  return result;
}

// This sets the environment's cache folder for as long as it lives.
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
  keep_machine_speed(file, some_key(), measured(5e9));
  keep_machine_speed(file, more_threads, measured(9e9));
  keep_machine_speed(file, some_key(), measured(6e9));
  EXPECT_EQ(kept_machine_speed(file, some_key())->speed.linear, 6e9);
  EXPECT_EQ(kept_machine_speed(file, some_key())->speed.large_model, 1.1);
  EXPECT_EQ(kept_machine_speed(file, more_threads)->speed.linear, 9e9);
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
  keep_machine_speed(file, some_key(), measured(5e9));
  EXPECT_EQ(kept_machine_speed(file, some_key())->speed.linear, 5e9);
  // A rate that is no speed.
  keep_machine_speed(file, some_key(), measured(0));
  EXPECT_FALSE(kept_machine_speed(file, some_key()));
}

// What a busy machine once made of them: attention at 192 % of the peak, int8 a fifth as fast as bfloat16.
TEST(MachineRates, ThoseThatContradictThemselvesAreNotKept) {
  EXPECT_THAT(contradictions(measured(9e9)), testing::IsEmpty());
  MeasuredSpeed busy = measured(9e9);
  busy.speed.attention = 19.2e9;
  busy.speed.bfloat16_linear = 2;
  busy.speed.int8_linear = 0.4;
  busy.spread = 0.57;
  busy.widest = "linear";
  EXPECT_THAT(
      contradictions(busy),
      testing::ElementsAre(
          "Attention reached 192 % of the multiply-add peak, which nothing can.",
          "Linear layers were 0.20 times as fast in int8 as in bfloat16, and a processor with both is no "
          "slower.",
          "Repeats of linear lay 57 % apart."));
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "machine_rates.json";
  keep_machine_speed(file, some_key(), busy);
  EXPECT_FALSE(kept_machine_speed(file, some_key()));
  // Of a program that kept no more than the rates.
  keep_machine_speed(file, some_key(), measured(9e9));
  ASSERT_TRUE(kept_machine_speed(file, some_key()));
  auto list = nlohmann::json::parse(read_file(file));
  list["rates"][0].erase("spread");
  write_file_atomically(file, list.dump());
  EXPECT_FALSE(kept_machine_speed(file, some_key()));
}

TEST(MachineRates, AreMendedByRuns) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "machine_rates.json";
  const auto learn = [&](double took) {
    const double now = kept_machine_speed(file, some_key())->speed.int8_stages;
    learn_from_run(file, some_key(),
                   {{ComputePrecision::kInt8, 100 * now, took}, {ComputePrecision::kFloat32, 0.1, 9}});
    return kept_machine_speed(file, some_key())->speed.int8_stages;
  };
  learn_from_run(file, some_key(), {{ComputePrecision::kInt8, 1, 2}});
  EXPECT_FALSE(std::filesystem::exists(file));  // nothing to mend
  keep_machine_speed(file, some_key(), measured(9e9));
  EXPECT_DOUBLE_EQ(learn(50), 0.75);  // the median of 1 and 0.5
  EXPECT_DOUBLE_EQ(learn(50), 0.5);
  EXPECT_DOUBLE_EQ(learn(5000), 0.75);  // one run on a busy machine among 0.5, 0.5 and 1
  EXPECT_EQ(kept_machine_speed(file, some_key())->speed.float32_stages, 1);  // too short to tell
  for (int i = 0; i < 20; ++i) learn(200);
  EXPECT_EQ(kept_machine_speed(file, some_key())->runs.at(ComputePrecision::kInt8).size(), 8u);
  EXPECT_DOUBLE_EQ(kept_machine_speed(file, some_key())->speed.int8_stages, 2);
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
