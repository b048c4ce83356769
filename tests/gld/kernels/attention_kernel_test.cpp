#include "gld/kernels/attention_kernel.h"

#include "tests/gld/kernels/attention_case.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::Case;
using test::expect_gradients;
using test::PropeCase;
using test::relative_error;
using test::shape_of;

class AttentionKernel : public testing::TestWithParam<InstructionSet> {
 protected:
  KernelSettings settings(int threads = 2) const {
    KernelSettings settings;
    settings.threads = threads;
    settings.instruction_set = GetParam();
    return settings;
  }
};

INSTANTIATE_TEST_SUITE_P(Portable, AttentionKernel, testing::Values(InstructionSet::kPortable));
INSTANTIATE_TEST_SUITE_P(on_avx2, AttentionKernel, testing::Values(InstructionSet::kAvx2));
INSTANTIATE_TEST_SUITE_P(on_avx512, AttentionKernel, testing::Values(InstructionSet::kAvx512));

TEST_P(AttentionKernel, AgreesWithDoubleForAllHeadSizesAndTokenCounts) {
  for (const int64_t head_dim : {1, 5, 8, 16, 20, 24, 32, 48, 64, 96, 128, 136}) {
    for (const auto& [queries, keys] :
         std::vector<std::pair<int64_t, int64_t>>{{1, 1}, {1, 37}, {61, 1}, {150, 203}}) {
      SCOPED_TRACE(testing::Message() << head_dim << " channels, " << queries << " x " << keys);
      Case problem(shape_of(queries, keys, head_dim), {});
      problem.forward(settings());
      EXPECT_LE(relative_error(problem.output, problem.reference().output), 2e-6);
      EXPECT_LE(relative_error(problem.log_sum_exp, problem.reference().log_sum_exp), 2e-6);
    }
  }
}

TEST_P(AttentionKernel, StaysWithinTwoMillionthsOverManyKeys) {
  for (const int64_t head_dim : {48, 128}) {
    Case problem({1, 1, 40, 5760, head_dim}, {});
    problem.forward(settings());
    EXPECT_LE(relative_error(problem.output, problem.reference().output), 2e-6);
  }
}

TEST_P(AttentionKernel, GradientsAgreeWithDouble) {
  for (const int64_t head_dim : {5, 16, 24, 48, 64, 96, 128}) {
    for (const auto& [queries, keys] :
         std::vector<std::pair<int64_t, int64_t>>{{1, 1}, {7, 130}, {131, 65}}) {
      SCOPED_TRACE(testing::Message() << head_dim << " channels, " << queries << " x " << keys);
      Case problem(shape_of(queries, keys, head_dim), {});
      expect_gradients(problem, settings(), 4e-6);
    }
  }
}

TEST_P(AttentionKernel, LargeTilesOfSeveralGroupsAgreeWithDouble) {
  for (const auto& [queries, keys] : std::vector<std::pair<int64_t, int64_t>>{{1601, 30}, {30, 1601}}) {
    SCOPED_TRACE(testing::Message() << queries << " x " << keys);
    Case problem({1, 2, queries, keys, 24}, {});
    problem.forward(settings(1));
    EXPECT_LE(relative_error(problem.output, problem.reference().output), 2e-6);
    expect_gradients(problem, settings(1), 4e-6);
  }
}

TEST_P(AttentionKernel, AppliesTheCameraEncoding) {
  for (const int64_t head_dim : {8, 16, 48, 128}) {
    for (const int64_t prefix : {0, 3}) {
      SCOPED_TRACE(testing::Message() << head_dim << " channels, " << prefix << " prefix tokens");
      const PropeCase prope(3, prefix, 4, 7, head_dim);
      const int64_t tokens = 3 * (prefix + 28);
      Case problem({1, 2, tokens, tokens, head_dim}, {0.2, 3});
      problem.use_prope(&prope.pointers);
      problem.forward(settings());
      EXPECT_LE(relative_error(problem.output, problem.reference().output), 4e-6);
      expect_gradients(problem, settings(), 1e-5);
    }
  }
}

TEST_P(AttentionKernel, SurvivesLogitsOfTenThousand) {
  // Integers, so that the logits themselves are exact and only the softmax is tested.
  Case problem({1, 1, 70, 90, 64}, {});
  std::mt19937 engine(2);
  std::uniform_int_distribution<int> digit(-20, 20);
  for (float& x : problem.query()) x = static_cast<float>(32 * digit(engine));
  for (float& x : problem.key()) x = static_cast<float>(digit(engine));
  const auto& expected = problem.reference();
  EXPECT_GT(*std::max_element(expected.log_sum_exp.begin(), expected.log_sum_exp.end()), 1e4);
  problem.forward(settings());
  // Logits are multiplied by log2(e) and rounded: 1e4 * 6e-8 in the exponent.
  EXPECT_LE(relative_error(problem.output, expected.output), 2e-3);
  EXPECT_LE(relative_error(problem.log_sum_exp, expected.log_sum_exp), 2e-6);
  problem.backward(settings());
  for (const float x : problem.query_gradient) EXPECT_TRUE(std::isfinite(x));
  for (const float x : problem.key_gradient) EXPECT_TRUE(std::isfinite(x));
}

TEST_P(AttentionKernel, EqualLogitsGiveTheMean) {
  Case problem({1, 1, 9, 300, 16}, {});
  std::fill(problem.key().begin(), problem.key().end(), 0.5f);
  problem.forward(settings());
  EXPECT_LE(relative_error(problem.output, problem.reference().output), 2e-6);
}

TEST_P(AttentionKernel, KeepsNotANumberVisible) {
  Case problem({1, 1, 4, 50, 16}, {});
  problem.query()[0] = std::numeric_limits<float>::quiet_NaN();
  problem.forward(settings());
  EXPECT_TRUE(std::isnan(problem.output[3]));
  EXPECT_TRUE(std::isfinite(problem.output[16]));
}

TEST_P(AttentionKernel, GivesTheSameBitsEveryTimeAndForAnyThreads) {
  Case first(shape_of(300, 300, 48), {});
  Case second(shape_of(300, 300, 48), {});
  first.backward(settings(2));
  second.backward(settings(2));
  EXPECT_EQ(first.output, second.output);
  EXPECT_EQ(first.query_gradient, second.query_gradient);
  EXPECT_EQ(first.key_gradient, second.key_gradient);
  second.backward(settings(1));
  EXPECT_EQ(first.output, second.output);
  EXPECT_EQ(first.value_gradient, second.value_gradient);
}

TEST_P(AttentionKernel, NeedsLessThan64MegabytesAtFullSize) {
  for (const int64_t head_dim : {48, 128}) {
    AttentionForward arrays;
    arrays.shape = {1, 16, 10368, 10368, head_dim};
    EXPECT_LT(attention_forward_scratch_bytes(arrays, settings(8)), 64 * 1024 * 1024);
  }
}

TEST(AttentionKernelErrors, NameWhatIsWrong) {
  AttentionForward arrays;
  arrays.shape = {1, 1, 4, 4, 300};
  EXPECT_EQ(test::error_of([&] { attention_forward(arrays, {}); }),
            "attention kernel: expected 1 to 256 channels a head, "
            "token counts of at least 0 and at least one thread, found 300 channels, 4 queries, 4 keys, "
            "1 threads.");
  arrays.shape = {1, 1, 5, 4, 16};
  const PropeCase prope(2, 0, 1, 3, 8);
  arrays.prope = &prope.pointers;
  EXPECT_EQ(test::error_of([&] { attention_forward(arrays, {}); }),
            "attention kernel: expected 6 queries and keys with a multiple of 8 channels a head for the "
            "camera encoding, found 5 queries and 4 keys with 16 channels.");
}

}  // namespace
}  // namespace gld
