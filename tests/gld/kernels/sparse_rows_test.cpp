// Sparse products beside the same in double, at every instruction set.
#include "gld/kernels/kernel_table.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

class SparseRowsProduct : public testing::TestWithParam<InstructionSet> {};

TEST_P(SparseRowsProduct, IsTheSumOverEntries) {
  std::mt19937 engine(3);
  std::uniform_real_distribution<float> uniform(-1, 1);
  constexpr int64_t kRows = 9, kColumns = 14;
  // Rows of 0, 1, 2 .. entries.
  std::vector<int64_t> first{0};
  std::vector<int32_t> columns;
  std::vector<float> values;
  for (int64_t row = 0; row < kRows; ++row) {
    for (int64_t k = 0; k < row; ++k) {
      columns.push_back(static_cast<int32_t>(engine() % kColumns));
      values.push_back(uniform(engine));
    }
    first.push_back(static_cast<int64_t>(columns.size()));
  }
  for (const int64_t stride : {16, 48, 64, 112}) {
    std::vector<float> table(static_cast<size_t>(kColumns * stride)),
        sums(static_cast<size_t>(kRows * stride), 7.0F);
    for (float& value : table) value = uniform(engine);
    kernel_table(GetParam())
        .sparse_rows(
            {first.data(), columns.data(), values.data(), 1, kRows, table.data(), stride, sums.data()});
    for (int64_t row = 0; row < kRows; ++row) {
      for (int64_t c = 0; c < stride; ++c) {
        double expected = row == 0 ? 7 : 0;  // the row before `begin` is left alone
        for (int64_t k = first[static_cast<size_t>(row)]; k < first[static_cast<size_t>(row) + 1]; ++k) {
          expected += static_cast<double>(values[static_cast<size_t>(k)]) *
                      table[static_cast<size_t>(columns[static_cast<size_t>(k)] * stride + c)];
        }
        // Eight products of at most 1.
        EXPECT_NEAR(sums[static_cast<size_t>(row * stride + c)], expected, 1e-6) << stride << " " << row;
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, SparseRowsProduct, testing::ValuesIn(available_instruction_sets()),
                         [](const testing::TestParamInfo<InstructionSet>& info) {
                           std::string name = instruction_set_name(info.param);
                           name.erase(std::remove(name.begin(), name.end(), '-'), name.end());
                           return name;
                         });

}  // namespace
}  // namespace gld
