// Every test begins with the same random numbers of LibTorch, which seeds its generator from the clock otherwise: what
// fails fails again. --gtest_random_seed=N draws others, as a bound that was fitted to one draw is found by hand alone.
// It is an object, because nobody has to call it.
#include <torch/utils.h>

#include <gtest/gtest.h>

namespace {

class Seeded : public testing::EmptyTestEventListener {
 public:
  void OnTestSuiteStart(const testing::TestSuite&) override { seed(); }
  void OnTestStart(const testing::TestInfo&) override { seed(); }

 private:
  static void seed() { torch::manual_seed(20261127 + static_cast<uint64_t>(GTEST_FLAG_GET(random_seed))); }
};

[[maybe_unused]] const bool listens = [] {
  testing::UnitTest::GetInstance()->listeners().Append(new Seeded());  // which owns it
  return true;
}();

}  // namespace
