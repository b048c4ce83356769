#include "gld/kernels/packed_product.h"

#include "gld/kernels/matrix_product.h"
#include "gld/kernels/matrix_unit_kernels.h"
#include "tests/gld/kernels/normal_floats.h"
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

using test::normals;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

struct Way {
  ComputePrecision precision;
  MatrixUnit unit;
};

// What one unit multiplies by its instructions for bfloat16, or by those for int8.
std::vector<Way> bfloat16_ways(MatrixUnit unit) { return {{ComputePrecision::kBFloat16, unit}}; }
Way int8_way(MatrixUnit unit) { return {ComputePrecision::kInt8, unit}; }

std::vector<Way> plain_ways() {
  auto all = bfloat16_ways(MatrixUnit::kPlain);
  all.push_back(int8_way(MatrixUnit::kPlain));
  all.push_back({ComputePrecision::kFloat32, MatrixUnit::kPlain});
  return all;
}

std::string name_of(const Way& way) {
  std::string name = compute_precision_name(way.precision) + "_" + matrix_unit_name(way.unit, way.precision);
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
}

PackingSettings settings_of(const Way& way) {
  PackingSettings settings;
  settings.precision = way.precision;
  settings.unit = way.unit;
  return settings;
}

// Rows a few floats further apart than they are long, and y full of NaN.
struct PackedCase {
  PackedCase(int64_t rows, int64_t inputs, int64_t outputs)
      : rows(rows),
        inputs(inputs),
        outputs(outputs),
        x(normals(rows * x_stride(), 1)),
        weight(normals(outputs * weight_stride(), 2)),
        bias(normals(outputs, 3)) {}

  int64_t x_stride() const { return inputs + 3; }
  int64_t weight_stride() const { return inputs + 1; }
  int64_t y_stride() const { return outputs + 5; }
  float* x_row(int64_t row) { return x.data() + row * x_stride(); }
  const float* x_row(int64_t row) const { return x.data() + row * x_stride(); }
  const float* weight_row(int64_t output) const { return weight.data() + output * weight_stride(); }
  WeightMatrix matrix() const { return {weight.data(), outputs, inputs, weight_stride()}; }

  std::vector<float> run(const Way& way, int threads) const { return run(settings_of(way), threads, rows); }
  std::vector<float> run(const PackingSettings& settings, int threads, int64_t first_rows) const {
    const PackedWeights packed(matrix(), settings);
    std::vector<float> y(static_cast<std::size_t>(rows * y_stride()), kNan);
    PackedProduct product;
    product.rows = first_rows;
    product.x = x.data();
    product.x_stride = x_stride();
    product.y_stride = y_stride();
    product.targets = {{&packed, bias.data(), y.data()}};
    packed_product(product, threads);
    return y;
  }
  float at(const std::vector<float>& y, int64_t row, int64_t output) const {
    return y[static_cast<std::size_t>(row * y_stride() + output)];
  }

  int64_t rows, inputs, outputs;
  std::vector<float> x, weight, bias;
};

// The sum in double, and what each precision may be off by: with u = 2^-8 half a unit in the last of 8 bits, products
// of rounded factors err by at most (2 u + u^2) |x w|; of int8, half a step of x times |w|, half a step of w times |x|
// and their product. To all of them comes the rounding of sums in float32 (int32 is exact), n eps of the sum of
// magnitudes, taken as (8 + sqrt n) eps for the random signs that tests have.
struct Bound {
  double value = 0;
  double error = 0;
};

Bound bound_of(const PackedCase& one, int64_t row, int64_t output, ComputePrecision precision) {
  const float* x = one.x_row(row);
  const float* w = one.weight_row(output);
  Bound bound;
  bound.value = one.bias[static_cast<std::size_t>(output)];
  double magnitudes = std::abs(bound.value), x_sum = 0, w_sum = 0, low = 0, high = 0, largest = 0;
  for (int64_t k = 0; k < one.inputs; ++k) {
    const double a = x[k], b = w[k];
    bound.value += a * b;
    magnitudes += std::abs(a * b);
    x_sum += std::abs(a);
    w_sum += std::abs(b);
    low = std::min(low, a);
    high = std::max(high, a);
    largest = std::max(largest, std::abs(b));
  }
  const double sums = (8 + std::sqrt(static_cast<double>(one.inputs))) * 0x1p-24 * magnitudes;
  switch (precision) {
    case ComputePrecision::kFloat32:
      bound.error = sums;
      break;
    case ComputePrecision::kBFloat16:
      bound.error = sums + (2 * 0x1p-8 + 0x1p-16) * magnitudes;
      break;
    case ComputePrecision::kInt8: {
      // Zero is rounded: that is up to another half step where x is clamped at an end of the range.
      const double x_step = (high - low) / 255, w_step = largest / 127;
      bound.error = sums + x_step * w_sum + 0.5 * w_step * x_sum +
                    0.5 * x_step * w_step * static_cast<double>(one.inputs);
      break;
    }
  }
  // Products whose sums are exactly zero are not asked for more than float32 can hold.
  bound.error += 1e-30;
  return bound;
}

class PackedProducts : public testing::TestWithParam<Way> {};

struct PackedShape {
  int64_t rows, inputs, outputs;
};

TEST_P(PackedProducts, StayWithinTheirBoundOfDouble) {
  const std::vector<PackedShape> shapes = {{1, 1, 1},       {7, 3, 5},     {8, 64, 48},    {33, 31, 33},
                                           {49, 257, 193},  {64, 5, 400},  {130, 531, 95}, {1160, 40, 100},
                                           {61, 1701, 101}, {35, 3300, 70}};
  for (const PackedShape& shape : shapes) {
    for (const int threads : {1, 3}) {
      const PackedCase one(shape.rows, shape.inputs, shape.outputs);
      const auto y = one.run(GetParam(), threads);
      for (int64_t row = 0; row < one.rows; ++row) {
        for (int64_t output = 0; output < one.outputs; ++output) {
          const Bound bound = bound_of(one, row, output, GetParam().precision);
          ASSERT_NEAR(one.at(y, row, output), bound.value, bound.error)
              << shape.rows << " x " << shape.inputs << " x " << shape.outputs << " at " << row << ", "
              << output;
        }
        for (int64_t gap = one.outputs; gap < one.y_stride(); ++gap) {
          ASSERT_TRUE(std::isnan(one.at(y, row, gap))) << "written between rows";
        }
      }
    }
  }
}

TEST_P(PackedProducts, GiveTheSameBitsForAnyThreadsAndRows) {
  const PackedCase one(200, 300, 130);
  const auto all = one.run(settings_of(GetParam()), 1, 200), some = one.run(settings_of(GetParam()), 3, 70);
  for (int64_t row = 0; row < 70; ++row) {
    for (int64_t output = 0; output < one.outputs; ++output) {
      ASSERT_EQ(one.at(all, row, output), one.at(some, row, output));
    }
  }
}

// Each kernel computes with its operands rounded as it says. Sums differ in order and so in rounding alone.
TEST_P(PackedProducts, AgreeWithThePlainUnitToRounding) {
  const PackedCase one(70, 1030, 101);
  const auto plain = one.run({GetParam().precision, MatrixUnit::kPlain}, 1);
  const auto y = one.run(GetParam(), 2);
  for (int64_t row = 0; row < one.rows; ++row) {
    for (int64_t output = 0; output < one.outputs; ++output) {
      // Sums of about 32 of terms of about 0.6 a term: 2e-6 of what they are made of.
      ASSERT_NEAR(one.at(y, row, output), one.at(plain, row, output), 2e-6 * 1030 * 0.64);
    }
  }
}

TEST_P(PackedProducts, ShareTheirInput) {
  const PackedCase first(40, 70, 90);
  PackedCase second = first;
  second.weight = normals(90 * second.weight_stride(), 4);
  const auto settings = settings_of(GetParam());
  const PackedWeights a(first.matrix(), settings), b(second.matrix(), settings);
  std::vector<float> y(40 * 180);
  PackedProduct product;
  product.rows = 40;
  product.x = first.x.data();
  product.x_stride = first.x_stride();
  product.y_stride = 180;
  product.targets = {{&a, first.bias.data(), y.data()}, {&b, nullptr, y.data() + 90}};
  packed_product(product, 2);
  std::fill(second.bias.begin(), second.bias.end(), 0.0f);
  const auto y_a = first.run(GetParam(), 1), y_b = second.run(GetParam(), 1);
  for (int64_t row = 0; row < 40; ++row) {
    for (int64_t output = 0; output < 90; ++output) {
      ASSERT_EQ(y[static_cast<std::size_t>(row * 180 + output)], first.at(y_a, row, output));
      ASSERT_EQ(y[static_cast<std::size_t>(row * 180 + 90 + output)], second.at(y_b, row, output));
    }
  }
}

// Rows of 1e-30, of 1e4, of one outlier of 1e30 and of zeros: none overflows, each keeps its own digits.
TEST_P(PackedProducts, KeepExtremeRowsApart) {
  PackedCase one(50, 200, 60);
  for (int64_t k = 0; k < one.inputs; ++k) {
    one.x_row(0)[k] *= 1e-30f;
    one.x_row(1)[k] *= 1e4f;
    one.x_row(3)[k] = 0;
  }
  one.x_row(2)[17] = 1e30f;
  const auto y = one.run(GetParam(), 2);
  for (int64_t row = 0; row < 5; ++row) {
    for (int64_t output = 0; output < one.outputs; ++output) {
      const Bound bound = bound_of(one, row, output, GetParam().precision);
      ASSERT_NEAR(one.at(y, row, output), bound.value, bound.error) << row;
    }
  }
}

TEST_P(PackedProducts, NeverHideANanOrAnInfinity) {
  PackedCase one(50, 200, 60);
  one.x_row(5)[199] = kNan;
  one.x_row(6)[0] = kInfinity;
  const auto y = one.run(GetParam(), 1);
  for (int64_t output = 0; output < one.outputs; ++output) {
    EXPECT_TRUE(std::isnan(one.at(y, 5, output)));
    EXPECT_FALSE(std::isfinite(one.at(y, 6, output)));
    EXPECT_TRUE(std::isfinite(one.at(y, 4, output)));
    EXPECT_TRUE(std::isfinite(one.at(y, 7, output)));
  }
  PackedCase weights(50, 200, 60);
  weights.weight[static_cast<std::size_t>(3 * weights.weight_stride() + 100)] = kNan;
  const auto z = weights.run(GetParam(), 1);
  for (int64_t row = 0; row < weights.rows; ++row) {
    EXPECT_TRUE(std::isnan(weights.at(z, row, 3)));
    EXPECT_TRUE(std::isfinite(weights.at(z, row, 4)));
  }
}

const auto kNames = [](const testing::TestParamInfo<Way>& info) { return name_of(info.param); };
INSTANTIATE_TEST_SUITE_P(Plain, PackedProducts, testing::ValuesIn(plain_ways()), kNames);
INSTANTIATE_TEST_SUITE_P(on_avx512_bf16, PackedProducts,
                         testing::ValuesIn(bfloat16_ways(MatrixUnit::kAvx512)), kNames);
INSTANTIATE_TEST_SUITE_P(on_avx512_vnni, PackedProducts, testing::Values(int8_way(MatrixUnit::kAvx512)),
                         kNames);
INSTANTIATE_TEST_SUITE_P(on_amx_bf16, PackedProducts, testing::ValuesIn(bfloat16_ways(MatrixUnit::kAmx)),
                         kNames);
INSTANTIATE_TEST_SUITE_P(on_amx_int8, PackedProducts, testing::Values(int8_way(MatrixUnit::kAmx)), kNames);

TEST(PackedFloats, GiveTheBitsOfTheProductThatPacksAsItGoes) {
  for (const PackedShape& shape :
       {PackedShape{60, 1701, 210}, PackedShape{8, 64, 48}, PackedShape{300, 300, 193}}) {
    const PackedCase one(shape.rows, shape.inputs, shape.outputs);
    std::vector<float> expected(static_cast<std::size_t>(one.rows * one.y_stride()), kNan);
    LinearProduct product;
    product.rows = one.rows;
    product.inputs = one.inputs;
    product.outputs = one.outputs;
    product.x = one.x.data();
    product.x_stride = one.x_stride();
    product.weight = one.weight.data();
    product.weight_stride = one.weight_stride();
    product.bias = one.bias.data();
    product.y = expected.data();
    product.y_stride = one.y_stride();
    linear_product(product, {2});
    const auto y = one.run({ComputePrecision::kFloat32, MatrixUnit::kPlain}, 1);
    for (int64_t row = 0; row < one.rows; ++row) {
      for (int64_t output = 0; output < one.outputs; ++output) {
        ASSERT_EQ(one.at(y, row, output), one.at(expected, row, output));
      }
    }
  }
}

TEST(PackedFloats, UnpackToTheSameBits) {
  const PackedCase one(1, 531, 210);
  const PackedWeights packed(one.matrix(), PackingSettings{});
  std::vector<float> weights(531 * 210, kNan);
  packed.unpack(weights.data());
  for (int64_t output = 0; output < 210; ++output) {
    for (int64_t k = 0; k < 531; ++k) {
      ASSERT_EQ(weights[static_cast<std::size_t>(output * 531 + k)], one.weight_row(output)[k]);
    }
  }
}

TEST(PackedWeights, SayTheirSizeAndWhatTheyCannotDo) {
  const PackedCase one(1, 100, 50);
  const PackedWeights packed(one.matrix(), settings_of({ComputePrecision::kBFloat16, MatrixUnit::kPlain}));
  // 50 outputs are two panels of 32, 100 inputs are 50 words, padded to 64.
  EXPECT_EQ(packed.bytes(), 64 * 64 * 4);
  std::vector<float> weights(5000);
  EXPECT_EQ(
      test::error_of([&] { packed.unpack(weights.data()); }),
      "packed weights: expected float32, of which nothing was rounded away, found bfloat16; keep the weights "
      "themselves.");
  EXPECT_EQ(
      test::error_of([&] {
        one.run(settings_of({ComputePrecision::kFloat32, MatrixUnit::kPlain}), 0, 1);
      }),
      "packed product: expected targets of equal inputs, precision and unit that fit their strides, and a "
      "thread, found no target, thread or row.");
}

class BFloat16Rounding : public testing::TestWithParam<MatrixUnit> {};

TEST_P(BFloat16Rounding, IsToTheNearestWithTiesToEven) {
  const auto& kernels = matrix_unit_kernels(GetParam(), ComputePrecision::kBFloat16);
  // 1 + 2^-8 lies between 1 and 1 + 2^-7, 1 + 3 2^-8 between that and 1 + 2^-6; there are a vector of them and a tail.
  std::vector<float> x(40, 1 + 0x1p-8f);
  x[1] = 1 + 3 * 0x1p-8f;
  x[2] = kNan;
  x[3] = -kInfinity;
  x[4] = 3.4e38f;
  x[39] = 1 + 3 * 0x1p-8f;
  std::vector<uint16_t> y(64, 0xffff);
  kernels.to_bfloat16(x.data(), 40, 64, y.data());
  EXPECT_EQ(y[0], 0x3f80);
  EXPECT_EQ(y[1], 0x3f82);
  EXPECT_TRUE((y[2] & 0x7f80) == 0x7f80 && (y[2] & 0x7f) != 0);
  EXPECT_EQ(y[3], 0xff80);
  EXPECT_EQ(y[4], 0x7f80);
  EXPECT_EQ(y[39], 0x3f82);
  EXPECT_EQ(y[40], 0);
  EXPECT_EQ(y[63], 0);
}

INSTANTIATE_TEST_SUITE_P(Plain, BFloat16Rounding, testing::Values(MatrixUnit::kPlain));
INSTANTIATE_TEST_SUITE_P(on_avx512_bf16, BFloat16Rounding, testing::Values(MatrixUnit::kAvx512));
INSTANTIATE_TEST_SUITE_P(on_amx_bf16, BFloat16Rounding, testing::Values(MatrixUnit::kAmx));

}  // namespace
}  // namespace gld
