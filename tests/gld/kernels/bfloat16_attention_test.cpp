#include "tests/gld/kernels/attention_case.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::Case;
using test::PropeCase;
using test::relative_error;
using test::shape_of;

// bfloat16 on every unit. Operands are rounded to u = 2^-8 relative, so that a logit errs by at most delta = (2 u +
// u^2) sum |q k| / sqrt(head_dim), a probability by the factor exp(2 delta) and its own rounding u, and a value by u:
// together exp(2 delta) (1 + u)^2 - 1 of the largest value, whatever the output's own size. 1e-3 for exponentials
// (9e-5) and sums.
class BFloat16Attention : public testing::TestWithParam<MatrixUnit> {
 protected:
  KernelSettings settings(int threads = 2) const {
    KernelSettings settings;
    settings.threads = threads;
    settings.precision = ComputePrecision::kBFloat16;
    settings.unit = GetParam();
    return settings;
  }
};

INSTANTIATE_TEST_SUITE_P(Plain, BFloat16Attention, testing::Values(MatrixUnit::kPlain));
INSTANTIATE_TEST_SUITE_P(on_avx512_bf16, BFloat16Attention, testing::Values(MatrixUnit::kAvx512));
INSTANTIATE_TEST_SUITE_P(on_amx_bf16, BFloat16Attention, testing::Values(MatrixUnit::kAmx));

// Returns the largest of |q| |k| per head: the largest logit without signs, over all batches and heads.
double largest_magnitude(Case& problem, const AttentionShape& shape) {
  double largest = 0;
  const int64_t row = shape.heads * shape.head_dim;
  for (int64_t batch = 0; batch < shape.batch; ++batch) {
    for (int64_t head = 0; head < shape.heads; ++head) {
      for (int64_t q = 0; q < shape.queries; ++q) {
        for (int64_t k = 0; k < shape.keys; ++k) {
          double sum = 0;
          const float* query = &problem.query()[static_cast<std::size_t>((batch * shape.queries + q) * row +
                                                                         head * shape.head_dim)];
          const float* key =
              &problem
                   .key()[static_cast<std::size_t>((batch * shape.keys + k) * row + head * shape.head_dim)];
          for (int64_t c = 0; c < shape.head_dim; ++c)
            sum += std::abs(static_cast<double>(query[c]) * key[c]);
          largest = std::max(largest, sum / std::sqrt(static_cast<double>(shape.head_dim)));
        }
      }
    }
  }
  return largest;
}

double largest_of(const std::vector<float>& values) {
  double largest = 0;
  for (const float x : values) largest = std::max(largest, std::abs(static_cast<double>(x)));
  return largest;
}

TEST_P(BFloat16Attention, StaysWithinItsBoundOfDouble) {
  constexpr double kHalfUnit = 0x1p-8;
  for (const int64_t head_dim : {1, 5, 8, 20, 48, 64, 128, 136}) {
    for (const auto& [queries, keys] :
         std::vector<std::pair<int64_t, int64_t>>{{1, 1}, {1, 37}, {61, 1}, {150, 203}, {250, 96}}) {
      SCOPED_TRACE(testing::Message() << head_dim << " channels, " << queries << " x " << keys);
      const AttentionShape shape = shape_of(queries, keys, head_dim);
      Case problem(shape, {});
      problem.forward(settings());
      const double delta = 2.01 * kHalfUnit * largest_magnitude(problem, shape);
      const double bound =
          (std::exp(2 * delta) * (1 + 2.01 * kHalfUnit) - 1 + 1e-3) * largest_of(problem.value());
      const auto& expected = problem.reference();
      double squares = 0, errors = 0;
      for (std::size_t i = 0; i < expected.output.size(); ++i) {
        const double error = problem.output[i] - expected.output[i];
        ASSERT_LE(std::abs(error), bound);
        errors += error * error;
        squares += expected.output[i] * expected.output[i];
      }
      // Bounds are for the worst case; signs are random, so that what is usual lies far below.
      EXPECT_LE(std::sqrt(errors / squares), 8e-3);
      for (std::size_t i = 0; i < expected.log_sum_exp.size(); ++i) {
        ASSERT_NEAR(problem.log_sum_exp[i], expected.log_sum_exp[i], delta + 1e-3);
      }
    }
  }
}

TEST_P(BFloat16Attention, AgreesWithThePlainUnitToRounding) {
  Case problem(shape_of(150, 203, 48), {}), plain(shape_of(150, 203, 48), {});
  problem.forward(settings());
  auto other = settings();
  other.unit = MatrixUnit::kPlain;
  plain.forward(other);
  // Exponentials of the two differ by up to 9e-5, so that a probability may be rounded the other way, by 2^-7 of
  // itself, as may a few of the 203 of each query: together below 2^-8 of the largest value.
  const std::vector<double> expected(plain.output.begin(), plain.output.end());
  EXPECT_LE(relative_error(problem.output, expected), 0x1p-8);
}

TEST_P(BFloat16Attention, AppliesTheCameraEncoding) {
  for (const int64_t head_dim : {8, 48}) {
    for (const int64_t prefix : {0, 3}) {
      const PropeCase prope(3, prefix, 4, 7, head_dim);
      const int64_t tokens = 3 * (prefix + 28);
      Case problem({1, 2, tokens, tokens, head_dim}, {0.2, 3});
      problem.use_prope(&prope.pointers);
      problem.forward(settings());
      // Random matrices make logits of several tens: as above, 2^-8 of them in the exponent.
      EXPECT_LE(relative_error(problem.output, problem.reference().output), 0.1);
    }
  }
}

TEST_P(BFloat16Attention, SurvivesLogitsOfTenThousand) {
  // Whole numbers below 256 and powers of two are bfloat16: what is rounded is the factor log2(e) / 8 of the queries.
  Case problem({1, 1, 70, 90, 64}, {});
  std::mt19937 engine(2);
  std::uniform_int_distribution<int> digit(-20, 20);
  for (float& x : problem.query()) x = static_cast<float>(32 * digit(engine));
  for (float& x : problem.key()) x = static_cast<float>(digit(engine));
  problem.forward(settings());
  const auto& expected = problem.reference().log_sum_exp;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    ASSERT_TRUE(std::isfinite(problem.log_sum_exp[i]));
    // They differ by 2^-8 of the products' magnitudes, of which the sum is a fraction.
    EXPECT_NEAR(problem.log_sum_exp[i], expected[i], 0x1p-8 * 64 * 640 * 20 / 8);
  }
  EXPECT_LE(largest_of(problem.output), 1.01 * largest_of(problem.value()));
}

TEST_P(BFloat16Attention, KeepsNotANumberVisible) {
  Case problem({1, 1, 4, 50, 16}, {});
  problem.query()[0] = std::numeric_limits<float>::quiet_NaN();
  problem.forward(settings());
  EXPECT_TRUE(std::isnan(problem.output[3]));
  EXPECT_TRUE(std::isfinite(problem.output[16]));
}

TEST_P(BFloat16Attention, GivesTheSameBitsForAnyThreads) {
  Case first(shape_of(300, 300, 48), {}), second(shape_of(300, 300, 48), {});
  first.forward(settings(3));
  second.forward(settings(1));
  EXPECT_EQ(first.output, second.output);
}

TEST_P(BFloat16Attention, NeedsLessThan64MegabytesAtFullSize) {
  for (const int64_t head_dim : {48, 128}) {
    AttentionForward arrays;
    arrays.shape = {1, 16, 10368, 10368, head_dim};
    EXPECT_LT(attention_forward_scratch_bytes(arrays, settings(8)), 64 * 1024 * 1024);
  }
}

double relative_rms(const std::vector<float>& found, const std::vector<double>& expected) {
  double squares = 0, errors = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    const double error = found[i] - expected[i];
    errors += error * error;
    squares += expected[i] * expected[i];
  }
  return squares > 0 ? std::sqrt(errors / squares) : std::sqrt(errors);
}

// Probabilities and gradients of logits are rounded to 2^-8 relative, as all operands are; signs are random, so that a
// gradient's error is a few of these of its own size (the most with one channel, where nothing averages).
void expect_bfloat16_gradients(Case& problem, const KernelSettings& settings, double tolerance = 1.6e-2) {
  problem.backward(settings);
  const auto expected = problem.reference_gradients();
  EXPECT_LE(relative_rms(problem.query_gradient, expected.query), tolerance);
  EXPECT_LE(relative_rms(problem.key_gradient, expected.key), tolerance);
  EXPECT_LE(relative_rms(problem.value_gradient, expected.value), tolerance);
}

TEST_P(BFloat16Attention, GradientsAreWithinTheRoundingOfDouble) {
  for (const int64_t head_dim : {1, 5, 8, 20, 48, 64, 128, 136}) {
    for (const auto& [queries, keys] : std::vector<std::pair<int64_t, int64_t>>{
             {1, 37}, {61, 2}, {96, 48}, {150, 203}, {193, 96}, {250, 33}}) {
      SCOPED_TRACE(testing::Message() << head_dim << " channels, " << queries << " x " << keys);
      Case problem(shape_of(queries, keys, head_dim), {});
      expect_bfloat16_gradients(problem, settings());
    }
  }
}

TEST_P(BFloat16Attention, GradientsOfNothingAreZero) {
  Case no_keys(shape_of(70, 0, 16), {});
  no_keys.backward(settings());
  EXPECT_EQ(largest_of(no_keys.query_gradient), 0);
  Case no_queries(shape_of(0, 70, 16), {});
  no_queries.backward(settings());
  EXPECT_EQ(largest_of(no_queries.key_gradient), 0);
  EXPECT_EQ(largest_of(no_queries.value_gradient), 0);
  for (const auto* gradient : {&no_keys.query_gradient, &no_queries.key_gradient}) {
    for (const float x : *gradient) ASSERT_TRUE(std::isfinite(x));
  }
}

TEST_P(BFloat16Attention, AQueryWithOneKeyHasNoGradient) {
  // The probability is 1 whatever the logit is; what is left of the gradient is rounding, of the size of the terms.
  Case problem(shape_of(61, 1, 48), {});
  problem.backward(settings());
  const auto expected = problem.reference_gradients();
  EXPECT_LE(relative_rms(problem.value_gradient, expected.value), 1.2e-2);
  EXPECT_LE(largest_of(problem.query_gradient), 0.3);
}

TEST_P(BFloat16Attention, GradientsGoThroughTheCameraEncoding) {
  for (const int64_t head_dim : {8, 48}) {
    const PropeCase prope(3, 3, 4, 7, head_dim);
    Case problem({1, 2, 93, 93, head_dim}, {0.05, 3});
    problem.use_prope(&prope.pointers);
    expect_bfloat16_gradients(problem, settings(), 4e-2);
  }
}

TEST_P(BFloat16Attention, GradientsAreTheSameBitsEachTime) {
  Case first(shape_of(250, 203, 48), {}), second(shape_of(250, 203, 48), {});
  first.backward(settings(3));
  second.backward(settings(3));
  EXPECT_EQ(first.query_gradient, second.query_gradient);
  EXPECT_EQ(first.key_gradient, second.key_gradient);
  EXPECT_EQ(first.value_gradient, second.value_gradient);
}

TEST_P(BFloat16Attention, GradientsOfExtremeLogitsAreFinite) {
  Case problem({1, 1, 70, 50, 64}, {1000, 2});
  for (float& x : problem.key()) x *= 100;
  problem.backward(settings());
  for (const auto* gradient : {&problem.query_gradient, &problem.key_gradient, &problem.value_gradient}) {
    for (const float x : *gradient) ASSERT_TRUE(std::isfinite(x));
  }
}

TEST_P(BFloat16Attention, GradientsKeepNotANumberVisible) {
  Case problem({1, 1, 4, 50, 16}, {});
  problem.value()[0] = std::numeric_limits<float>::quiet_NaN();
  problem.backward(settings());
  EXPECT_TRUE(std::isnan(problem.query_gradient[3]));
  EXPECT_TRUE(std::isnan(problem.key_gradient[0]));
}

}  // namespace
}  // namespace gld
