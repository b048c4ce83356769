#include "gld/kernels/attention_kernel.h"

#include "tests/support/attention_reference.h"
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

// Everything one case needs: float arrays as the kernel reads them (query, key and value are slices of one array, as
// after a joint projection), and the same numbers in double.
class Case {
 public:
  struct Draw {
    double logit_scale = 1;
    unsigned seed = 1;
  };

  Case(const AttentionShape& shape, const Draw& draw) : shape_(shape) {
    std::mt19937 engine(draw.seed);
    std::normal_distribution<float> normal;
    const auto fill = [&](int64_t tokens, double scale, std::vector<float>& values) {
      values.resize(static_cast<std::size_t>(shape.batch * tokens * shape.heads * shape.head_dim));
      for (float& x : values) x = static_cast<float>(scale) * normal(engine);
    };
    fill(shape.queries, draw.logit_scale, query_);
    fill(shape.keys, 1, key_);
    fill(shape.keys, 1, value_);
    fill(shape.queries, 1, output_gradient_);
  }

  void use_prope(const PropePointers* prope) { prope_ = prope; }
  void use_mask(const ViewMask* mask) { mask_ = mask; }
  std::vector<float>& query() { return query_; }
  std::vector<float>& key() { return key_; }
  std::vector<float>& value() { return value_; }

  AttentionForward forward_arrays() {
    AttentionForward arrays;
    arrays.shape = shape_;
    arrays.query = view<const float>(query_, shape_.queries);
    arrays.key = view<const float>(key_, shape_.keys);
    arrays.value = view<const float>(value_, shape_.keys);
    arrays.prope = prope_;
    arrays.mask = mask_;
    output.assign(query_.size(), std::numeric_limits<float>::quiet_NaN());
    log_sum_exp.assign(static_cast<std::size_t>(shape_.batch * shape_.heads * shape_.queries), 7.0f);
    arrays.output = view<float>(output, shape_.queries);
    arrays.log_sum_exp = log_sum_exp.data();
    return arrays;
  }

  void forward(const KernelSettings& settings) { attention_forward(forward_arrays(), settings); }

  void backward(const KernelSettings& settings) {
    AttentionBackward arrays;
    arrays.forward = forward_arrays();
    attention_forward(arrays.forward, settings);
    const float nan = std::numeric_limits<float>::quiet_NaN();
    query_gradient.assign(query_.size(), nan);
    key_gradient.assign(key_.size(), nan);
    value_gradient.assign(value_.size(), nan);
    arrays.output_gradient = view<const float>(output_gradient_, shape_.queries);
    arrays.query_gradient = view<float>(query_gradient, shape_.queries);
    arrays.key_gradient = view<float>(key_gradient, shape_.keys);
    arrays.value_gradient = view<float>(value_gradient, shape_.keys);
    attention_backward(arrays, settings);
  }

  const test::ReferenceAttention& reference() {
    if (reference_.output.empty()) {
      reference_.query.assign(query_.begin(), query_.end());
      reference_.key.assign(key_.begin(), key_.end());
      reference_.value.assign(value_.begin(), value_.end());
      test::run_reference(shape_, prope_, mask_, reference_);
    }
    return reference_;
  }

  test::ReferenceGradients reference_gradients() {
    const std::vector<double> gradient(output_gradient_.begin(), output_gradient_.end());
    return test::reference_gradients(shape_, prope_, mask_, reference(), gradient);
  }

  std::vector<float> output, log_sum_exp, query_gradient, key_gradient, value_gradient;

 private:
  template <class Float, class Array>
  StridedHeads<Float> view(Array& array, int64_t tokens) const {
    return {array.data(), tokens * shape_.heads * shape_.head_dim, shape_.heads * shape_.head_dim,
            shape_.head_dim};
  }

  AttentionShape shape_;
  const PropePointers* prope_ = nullptr;
  const ViewMask* mask_ = nullptr;
  std::vector<float> query_, key_, value_, output_gradient_;
  test::ReferenceAttention reference_;
};

// max |a - b| / max |b|; infinite when a value is not finite.
double relative_error(const std::vector<float>& found, const std::vector<double>& expected) {
  double error = 0, largest = 0;
  EXPECT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (!std::isfinite(found[i])) return std::numeric_limits<double>::infinity();
    error = std::max(error, std::abs(static_cast<double>(found[i]) - expected[i]));
    largest = std::max(largest, std::abs(expected[i]));
  }
  return largest > 0 ? error / largest : error;
}

void expect_gradients(Case& problem, const KernelSettings& settings, double tolerance) {
  problem.backward(settings);
  const auto expected = problem.reference_gradients();
  EXPECT_LE(relative_error(problem.query_gradient, expected.query), tolerance);
  EXPECT_LE(relative_error(problem.key_gradient, expected.key), tolerance);
  EXPECT_LE(relative_error(problem.value_gradient, expected.value), tolerance);
}

AttentionShape shape_of(int64_t queries, int64_t keys, int64_t head_dim) {
  return {2, 2, queries, keys, head_dim};
}

// Random tables for a scene; what they hold is up to gld/cameras/prope.h and of no concern here.
struct PropeCase {
  PropeCase(int64_t views, int64_t prefix, int64_t height, int64_t width, int64_t head_dim) {
    std::mt19937 engine(5);
    std::normal_distribution<float> normal;
    const auto fill = [&](int64_t count, std::vector<float>& values) {
      values.resize(static_cast<std::size_t>(count));
      for (float& x : values) x = normal(engine);
    };
    fill(views * 16, query);
    fill(views * 16, key_value);
    fill(views * 16, output);
    const auto angles = [&](int64_t count, std::vector<float>& cosines, std::vector<float>& sines) {
      fill(count, cosines);
      sines = cosines;
      for (float& x : cosines) x = std::cos(x);
      for (float& x : sines) x = std::sin(x);
    };
    angles(width * head_dim / 8, column_cos, column_sin);
    angles(height * head_dim / 8, row_cos, row_sin);
    pointers = {views,
                prefix,
                height,
                width,
                query.data(),
                key_value.data(),
                output.data(),
                column_cos.data(),
                column_sin.data(),
                row_cos.data(),
                row_sin.data()};
  }

  std::vector<float> query, key_value, output, column_cos, column_sin, row_cos, row_sin;
  PropePointers pointers;
};

class AttentionKernel : public testing::TestWithParam<InstructionSet> {
 protected:
  KernelSettings settings(int threads = 2) const {
    KernelSettings settings;
    settings.threads = threads;
    settings.instruction_set = GetParam();
    return settings;
  }
};

INSTANTIATE_TEST_SUITE_P(InstructionSets, AttentionKernel, testing::ValuesIn(available_instruction_sets()),
                         [](const testing::TestParamInfo<InstructionSet>& info) {
                           std::string name = instruction_set_name(info.param);
                           name.erase(std::remove(name.begin(), name.end(), '-'), name.end());
                           return name;
                         });

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

TEST_P(AttentionKernel, LeavesOutPairsOfViews) {
  // Views 0 and 1 see each other, 2 sees nothing, 3 sees all but itself, and nobody sees 2 but 3.
  const std::vector<uint8_t> attends = {1, 1, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 1, 1, 1, 0};
  const ViewMask mask = {4, attends.data()};
  Case problem({1, 2, 4 * 53, 4 * 29, 48}, {});
  problem.use_mask(&mask);
  problem.forward(settings());
  EXPECT_LE(relative_error(problem.output, problem.reference().output), 2e-6);
  for (int64_t i = 2 * 53; i < 3 * 53; ++i) {
    EXPECT_EQ(problem.output[static_cast<std::size_t>(i * 96)], 0.0f);
    EXPECT_EQ(problem.log_sum_exp[static_cast<std::size_t>(i)], -std::numeric_limits<float>::infinity());
  }
  expect_gradients(problem, settings(), 4e-6);
}

TEST_P(AttentionKernel, SeparatedViewsEqualViewsAlone) {
  const std::vector<uint8_t> attends = {1, 0, 0, 1};
  const ViewMask mask = {2, attends.data()};
  Case joint({1, 1, 100, 100, 32}, {});
  joint.use_mask(&mask);
  joint.forward(settings());
  Case first({1, 1, 50, 50, 32}, {});
  std::copy_n(joint.query().begin(), 50 * 32, first.query().begin());
  std::copy_n(joint.key().begin(), 50 * 32, first.key().begin());
  std::copy_n(joint.value().begin(), 50 * 32, first.value().begin());
  first.forward(settings());
  EXPECT_EQ(first.output, std::vector<float>(joint.output.begin(), joint.output.begin() + 50 * 32));
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

INSTANTIATE_TEST_SUITE_P(Units, BFloat16Attention,
                         testing::ValuesIn(available_matrix_units(ComputePrecision::kBFloat16)),
                         [](const testing::TestParamInfo<MatrixUnit>& info) {
                           return matrix_unit_name(info.param);
                         });

// Of |q| |k| per head: the largest logit without signs, over all batches and heads.
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

TEST_P(BFloat16Attention, LeavesOutPairsOfViews) {
  // As for float32; views of 29 keys are an odd number, and each still starts a pair.
  const std::vector<uint8_t> attends = {1, 1, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 1, 1, 1, 0};
  const ViewMask mask = {4, attends.data()};
  Case problem({1, 2, 4 * 53, 4 * 29, 48}, {});
  problem.use_mask(&mask);
  problem.forward(settings());
  EXPECT_LE(relative_error(problem.output, problem.reference().output), 2e-2);
  for (int64_t i = 2 * 53; i < 3 * 53; ++i) {
    EXPECT_EQ(problem.output[static_cast<std::size_t>(i * 96)], 0.0f);
    EXPECT_EQ(problem.log_sum_exp[static_cast<std::size_t>(i)], -std::numeric_limits<float>::infinity());
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
    // 2^-8 of the products' magnitudes, of which the sum is a fraction.
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

TEST(AttentionKernelErrors, NameWhatIsWrong) {
  AttentionForward arrays;
  arrays.shape = {1, 1, 4, 4, 300};
  EXPECT_EQ(test::error_of([&] { attention_forward(arrays, {}); }),
            "attention kernel: expected 1 to 256 channels a head, "
            "token counts of at least 0 and at least one thread, found 300 channels, 4 queries, 4 keys, "
            "1 threads.");
  arrays.shape = {1, 1, 5, 4, 16};
  const std::vector<uint8_t> attends = {1, 1, 1, 1};
  const ViewMask mask = {2, attends.data()};
  arrays.mask = &mask;
  EXPECT_EQ(test::error_of([&] { attention_forward(arrays, {}); }),
            "attention kernel: expected tokens that divide evenly into the 2 views of the mask, "
            "found 5 queries and 4 keys.");
  const PropeCase prope(2, 0, 1, 3, 8);
  arrays.mask = nullptr;
  arrays.prope = &prope.pointers;
  EXPECT_EQ(test::error_of([&] { attention_forward(arrays, {}); }),
            "attention kernel: expected 6 queries and keys with a multiple of 8 channels a head for the "
            "camera encoding, found 5 queries and 4 keys with 16 channels.");
}

}  // namespace
}  // namespace gld
