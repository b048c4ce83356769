#include "gld/kernels/matrix_product.h"

#include "tests/gld/kernels/normal_floats.h"

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

// Rows a few floats further apart than they are long, and y full of NaN.
struct ProductCase {
  ProductCase(int64_t rows, int64_t inputs, int64_t outputs, bool with_bias) {
    product.rows = rows;
    product.inputs = inputs;
    product.outputs = outputs;
    product.x_stride = inputs + 3;
    product.weight_stride = inputs + 1;
    product.y_stride = outputs + 5;
    x = normals(rows * product.x_stride, 1);
    weight = normals(outputs * product.weight_stride, 2);
    bias = normals(outputs, 3);
    y.assign(static_cast<std::size_t>(rows * product.y_stride), std::numeric_limits<float>::quiet_NaN());
    product.x = x.data();
    product.weight = weight.data();
    product.bias = with_bias ? bias.data() : nullptr;
    product.y = y.data();
  }

  double expected(int64_t row, int64_t output) const {
    double sum = product.bias == nullptr ? 0 : bias[static_cast<std::size_t>(output)];
    for (int64_t k = 0; k < product.inputs; ++k) {
      sum += static_cast<double>(product.x[row * product.x_stride + k]) *
             static_cast<double>(product.weight[output * product.weight_stride + k]);
    }
    return sum;
  }

  // Returns the largest error beside the root of the number of terms, which is how large results are; checks too that
  // nothing was written between the rows.
  double largest_error() const {
    double largest = 0;
    for (int64_t row = 0; row < product.rows; ++row) {
      for (int64_t output = 0; output < product.outputs; ++output) {
        const double got = y[static_cast<std::size_t>(row * product.y_stride + output)];
        largest = std::max(largest, std::isnan(got) ? 1 : std::abs(got - expected(row, output)));
      }
      for (int64_t gap = product.outputs; gap < product.y_stride; ++gap) {
        EXPECT_TRUE(std::isnan(y[static_cast<std::size_t>(row * product.y_stride + gap)]));
      }
    }
    return largest / std::sqrt(static_cast<double>(product.inputs));
  }

  LinearProduct product;
  std::vector<float> x, weight, bias, y;
};

struct ProductShape {
  int64_t rows, inputs, outputs;
};

class MatrixProduct : public testing::TestWithParam<InstructionSet> {};

TEST_P(MatrixProduct, AgreesWithDouble) {
  const std::vector<ProductShape> shapes = {{1, 1, 1},       {7, 3, 5},      {8, 64, 48},
                                            {49, 257, 193},  {64, 5, 400},   {130, 531, 95},
                                            {1160, 40, 100}, {300, 300, 60}, {61, 1701, 101}};
  for (const ProductShape& shape : shapes) {
    for (const int threads : {1, 3}) {
      for (const bool with_bias : {false, true}) {
        ProductCase one(shape.rows, shape.inputs, shape.outputs, with_bias);
        linear_product(one.product, {threads, GetParam()});
        EXPECT_LT(one.largest_error(), 2e-6)
            << shape.rows << " x " << shape.inputs << " x " << shape.outputs << ", " << threads << " threads";
      }
    }
  }
}

TEST_P(MatrixProduct, GivesTheSameBitsForAnyCache) {
  ProductCase small(60, 1701, 210, true), large(60, 1701, 210, true);
  KernelSettings settings;
  settings.instruction_set = GetParam();
  settings.second_level_cache = int64_t{256} << 10;
  linear_product(small.product, settings);
  settings.second_level_cache = int64_t{2} << 20;
  linear_product(large.product, settings);
  for (int64_t row = 0; row < 60; ++row) {
    for (int64_t output = 0; output < 210; ++output) {
      const auto place = static_cast<std::size_t>(row * small.product.y_stride + output);
      ASSERT_EQ(small.y[place], large.y[place]);
    }
  }
}

TEST_P(MatrixProduct, GivesTheSameBitsForAnyThreadsAndRows) {
  ProductCase all(200, 300, 130, true), some(200, 300, 130, true);
  linear_product(all.product, {1, GetParam()});
  some.product.rows = 70;
  linear_product(some.product, {3, GetParam()});
  for (int64_t row = 0; row < 70; ++row) {
    for (int64_t output = 0; output < 130; ++output) {
      const auto place = static_cast<std::size_t>(row * all.product.y_stride + output);
      ASSERT_EQ(all.y[place], some.y[place]);
    }
  }
}

// One row, whole tiles of 4 rows and 3 outputs and what is left of them, inputs below a vector, whole vectors, and more
// than are summed up at once. The error of a sum of normal products is at most a few roundings of its size,
// sqrt(inputs), as above.
TEST_P(MatrixProduct, OfFewRowsAgreesWithDouble) {
  const std::vector<ProductShape> shapes = {{1, 1, 1},    {1, 3, 5},      {4, 16, 3},   {7, 64, 50},
                                            {17, 77, 49}, {47, 1701, 20}, {3, 9001, 7}, {2, 33, 400}};
  for (const ProductShape& shape : shapes) {
    for (const int threads : {1, 3}) {
      for (const bool with_bias : {false, true}) {
        ProductCase one(shape.rows, shape.inputs, shape.outputs, with_bias);
        few_rows_product(one.product, {threads, GetParam()});
        EXPECT_LT(one.largest_error(), 2e-6)
            << shape.rows << " x " << shape.inputs << " x " << shape.outputs << ", " << threads << " threads";
      }
    }
  }
}

TEST_P(MatrixProduct, OfFewRowsGivesTheSameBitsForAnyThreadsAndRows) {
  ProductCase all(47, 300, 130, true), some(47, 300, 130, true);
  few_rows_product(all.product, {1, GetParam()});
  some.product.rows = 14;
  few_rows_product(some.product, {3, GetParam()});
  for (int64_t row = 0; row < 14; ++row) {
    for (int64_t output = 0; output < 130; ++output) {
      const auto place = static_cast<std::size_t>(row * all.product.y_stride + output);
      ASSERT_EQ(all.y[place], some.y[place]);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Portable, MatrixProduct, testing::Values(InstructionSet::kPortable));
INSTANTIATE_TEST_SUITE_P(on_avx2, MatrixProduct, testing::Values(InstructionSet::kAvx2));
INSTANTIATE_TEST_SUITE_P(on_avx512, MatrixProduct, testing::Values(InstructionSet::kAvx512));

}  // namespace
}  // namespace gld
